"""Refinement that keeps a certificate (`jaxnarx.refinement.certificate`).

All is refined freely. Where that loses the certificate, the coefficients of past
outputs go back towards those of the start, as far as they must: with the norm of the
start as constraint the set of them that is certified is convex, so that there is a way.
The remaining parameters are then refined once more around them.
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.models import Network, OutputModel, fed_back_variables
from jaxnarx.refinement._stability import attach_certificate, certificate
from jaxnarx.simulation import simulate
from jaxnarx.solution import RESULTS, Solution

MOST_HALVINGS = 10
"""Halvings of the way back to the start."""
STILL_DEVIATION_SHARE = 1e-6
"""Standard deviation of a coefficient that stays, in shares of its size."""

Refine = Callable[[Network, Network | None], Solution[Network]]
"""A function that refines from a start, with standard deviations of a prior around
it."""


def refine_stable(
    network: Network, judge: Dataset, refine: Refine
) -> Solution[Network]:
    """The best of the start and of what `refine` makes of it that has a certificate.

    `judge` are records whose free run decides. `SpecError` where the start has none.
    """
    if certificate(network) is None:
        raise SpecError(
            "stable: the network has no certificate to keep. One whose local models "
            "share their feedback, or are close to doing so, has one: see "
            'jaxnarx.refinement.certificate, and identify with preset="ecu"',
            field="stable",
        )
    bounds = {"lower": network.lower, "upper": network.upper}
    found = refine(network, None)
    if certificate(found.value) is not None:
        value = dataclasses.replace(attach_certificate(found.value), **bounds)
        return dataclasses.replace(found, value=value)
    back = _pull_towards(network, found.value)
    again = refine(back, _fix_feedback(back))
    every = [network, back, _pull_towards(back, again.value)]
    errors = [_error(one, judge) for one in every]
    best = int(np.argmin(errors))
    detail = (
        f"{again.detail}; feedback held back to keep the certificate "
        f"({np.sqrt(_error(found.value, judge)):.4g} without)"
    )
    status = again.status if best else RESULTS.no_improvement
    value = dataclasses.replace(attach_certificate(every[best]), **bounds)
    return dataclasses.replace(again, value=value, status=status, detail=detail)


def _pull_towards(start: Network, end: Network) -> Network:
    """The end, with past outputs' coefficients as near to it as has a certificate."""

    def interpolate(share: float) -> Network:
        models = [
            eqx.tree_at(
                lambda model: model.local.coefficient,
                new,
                jnp.where(
                    _feedback_terms(end, new),
                    old.local.coefficient
                    + share * (new.local.coefficient - old.local.coefficient),
                    new.local.coefficient,
                ),
            )
            for old, new in zip(start.models, end.models, strict=True)
        ]
        return dataclasses.replace(end, models=tuple(models))

    if certificate(interpolate(1.0)) is not None:
        return interpolate(1.0)
    low, high = 0.0, 1.0
    for _ in range(MOST_HALVINGS):
        middle = 0.5 * (low + high)
        if certificate(interpolate(middle)) is None:
            high = middle
        else:
            low = middle
    return interpolate(low)


def _feedback_terms(
    network: Network, model: OutputModel
) -> Bool[np.ndarray, "models slots"]:
    """Coefficients of terms that hold a past output."""
    fed = {
        row + 1 for row, *_ in fed_back_variables(network.variables, network.signals)
    }
    terms = np.any(np.isin(np.asarray(model.local.factor), list(fed)), axis=1)
    terms = np.atleast_1d(terms)
    return terms[np.asarray(model.local.index)]


def _fix_feedback(network: Network) -> Network:
    """A prior that holds the coefficients of past outputs, and nothing else."""
    free = jax.tree.map(lambda leaf: jnp.full(jnp.shape(leaf), jnp.inf), network)
    models = []
    for own, model in zip(network.models, free.models, strict=True):
        value = jnp.abs(own.local.coefficient)
        size = STILL_DEVIATION_SHARE * jnp.maximum(value, STILL_DEVIATION_SHARE)
        still = jnp.where(_feedback_terms(network, own), size, jnp.inf)
        models.append(eqx.tree_at(lambda m: m.local.coefficient, model, still))
    return dataclasses.replace(free, models=tuple(models))


def _error(network: Network, data: Dataset) -> float:
    """Mean squared error of the free run in the outputs' variances."""
    run = simulate(network, data).value
    if any(d.any() for d in run.diverged):
        return np.inf
    own = list(network.modelled)
    parts = list(zip(data, run.outputs, run.scored, strict=True))
    total = []
    for k, o in enumerate(own):
        y = np.concatenate([r.y[s[:, k], o] for r, _, s in parts])
        error = y - np.concatenate([run[s[:, k], k] for _, run, s in parts])
        total.append(np.mean(error**2) / max(float(np.var(y)), 1e-300))
    return float(np.mean(total))
