"""The coefficients in which engines of a population differ, as one vector.

Their unit is such that each moves the free run of the donors by the standard deviation
of its output, so that one number says of all of them what is much.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.errors import SpecError
from jaxnarx.models import Network, OutputModel
from jaxnarx.refinement import Layout, freeze, label, make_layout

WIDTH_BAND = (0.5, 2.0)
"""Widths of Gaussians stay within these multiples of what they were."""


class FleetCoefficients(eqx.Module):
    """Places v in the network of a population, u = start + scale v at `free`.

    `layout` puts u, all trained parameters, in the network; `free` are those that
    differ between engines.
    """

    layout: Layout
    start: Float[Array, " entries"]
    free: Int[Array, " params"]
    scale: Float[Array, " params"]

    def vector(self, v: Float[Array, " params"]) -> Float[Array, " entries"]:
        """The trained parameters in solver coordinates."""
        return self.start.at[self.free].add(self.scale * v)

    def place(self, v: Float[Array, " params"]) -> Network:
        """The network with these deviations from its own coefficients."""
        return self.layout.place(self.vector(v))


def choose_coefficients(
    network: Network, *, gates: bool, feedback: bool
) -> FleetCoefficients:
    """The used coefficients of all local models, in units of their own.

    With `gates` what places the regions varies too; without `feedback` terms that hold
    what the network computes keep their coefficients, so that a free run is linear in
    all others.
    """
    trained = freeze(network, partition=gates)
    layout = make_layout(network, trained, WIDTH_BAND, centred=True, every=True)
    free = label(network, layout).real
    if not feedback:
        free = free & ~_entries_with(network, layout, network.signals)
    at = np.flatnonzero(free)
    if not len(at):
        raise SpecError(
            "the network has no coefficient in which engines could differ",
            field="network",
        )
    start = layout.gather(network)
    return FleetCoefficients(
        layout, start, jnp.asarray(at), jnp.ones(len(at), start.dtype)
    )


def names_of(coefficients: FleetCoefficients) -> list[str]:
    """The coefficients' names for people."""
    names = label(coefficients.layout.base, coefficients.layout).names
    return [names[n] for n in np.asarray(coefficients.free).tolist()]


def outputs_of(coefficients: FleetCoefficients) -> Int[np.ndarray, " params"]:
    """For every coefficient the output, or hidden channel, in whose equation it is."""
    owner = label(coefficients.layout.base, coefficients.layout).output
    return owner[np.asarray(coefficients.free)].astype(int)


def offset_and_gain(coefficients: FleetCoefficients) -> Float[np.ndarray, "params two"]:
    """The directions in which every output gets an offset, and a gain, of its own.

    The gain multiplies all terms of an output but those of its own past: exact where
    these are linear. By unit length of the effect: an offset of one standard deviation,
    a gain of one.
    """
    layout = coefficients.layout
    network, free = layout.base, np.asarray(coefficients.free)
    columns = []
    for o, model in enumerate(network.models[: len(network.modelled)]):
        theta = np.asarray(model.local.coefficient)
        past = _terms_with(network, model, (network.signals[o],))
        constant = _terms_with(network, model, None)
        columns += [
            _vector(layout, o, np.where(constant, theta + 1.0, theta)),
            _vector(layout, o, np.where(past, theta, 2.0 * theta)),
        ]
    table = (np.stack(columns, axis=1) - _vector(layout, 0, None)[:, None])[free]
    return table / np.asarray(coefficients.scale)[:, None]


def _vector(
    layout: Layout, o: int, coefficient: np.ndarray | None
) -> Float[np.ndarray, " entries"]:
    """The trained parameters with other coefficients of one output."""
    network = layout.base
    if coefficient is not None:
        network = eqx.tree_at(
            lambda n: n.models[o].local.coefficient, network, jnp.asarray(coefficient)
        )
    return np.asarray(layout.gather(network))


def _terms_with(
    network: Network, model: OutputModel, signals: tuple[int, ...] | None
) -> Bool[np.ndarray, "models slots"]:
    """Used terms that hold one of the signals; None: constants."""
    rows = [s for s, _ in network.variables]
    seen = np.array([False, *(signals is not None and s in signals for s in rows)])
    factor = np.asarray(model.local.factor)[np.asarray(model.local.index)]
    found = seen[factor].any(axis=2) if signals else ~np.any(factor, axis=2)
    return found & np.asarray(model.local.used)


def _entries_with(
    network: Network, layout: Layout, signals: tuple[int, ...]
) -> Bool[np.ndarray, " entries"]:
    """Coefficients of terms that hold one of the signals."""
    flags = np.zeros(layout.low.shape[0], bool)
    rows = zip(network.models, layout.chosen, layout.spans(), strict=True)
    for model, keep, (first, _) in rows:
        if keep[0]:
            own = _terms_with(network, model, signals).reshape(-1)
            flags[first : first + own.size] = own
    return flags
