"""Whether what a model file holds belongs together: sizes, kinds and indices."""

from typing import Any

import numpy as np

from jaxnarx.models.domain import LAYERS, Domain
from jaxnarx.models.error_model import STORED_PROBABILITIES, ErrorModel
from jaxnarx.models.network import Network, OutputModel
from jaxnarx.regressors import require_sampled

LARGEST_DEGREE = 8
"""Largest degree read; the recursion's tables grow without bound with it."""
LARGEST_LAG = 10**6
"""Largest lag read [samples]."""


def _require(holds: Any, otherwise: str) -> None:
    if not holds:
        raise ValueError(otherwise)


def require_consistent(network: Network) -> None:
    """Sizes, kinds and indices that belong together; a wrong one is a ValueError."""
    signals, outputs = (len(network.channels.all),), (len(network.models),)
    for name in ("gain", "low", "high"):
        shape = getattr(network, name).shape
        _require(shape == signals, f"{name} has not one entry per channel")
    for name in ("lower", "upper"):
        shape = getattr(network, name).shape
        _require(shape == outputs, f"{name} has not one entry per output")
    _require(network.sample_time.shape == (), "the sample time is not one number")
    _require(float(network.sample_time) > 0, "the sample time is not positive")
    hold = network.hold
    _require(hold is None or hold.shape == (), "the margin of limits is not one number")
    _require(hold is None or float(hold) >= 0, "the margin of limits is negative")
    _require(np.all(np.asarray(network.gain) > 0), "a gain is not positive")
    _require(network.modelled, "no output is modelled")
    _require(
        len(set(network.modelled)) == len(network.modelled)
        and all(0 <= o < len(network.channels.outputs) for o in network.modelled),
        "a modelled output is not among the channels, or is twice",
    )
    _check_magnitudes(network)
    _require(0 <= network.window <= LARGEST_LAG, "the window of hidden channels")
    own = network.signals
    tables = [network.variables, *(m.scheduling for m in network.models)]
    _require(
        all(d > 0 for table in tables for s, d in table if s in own),
        "a modelled output is used before it is computed",
    )
    for table in tables:
        require_sampled(table.filters, float(network.sample_time))
    for model in network.models:
        _check_model(model, len(network.variables) + 1)
    if network.certificate is not None:
        size = network.certificate.shape
        _require(len(size) == 2 and size[0] == size[1], "the certificate is no norm")
    if network.domain is not None:
        _check_domain(network.domain)
    if network.errors is not None:
        _require(network.domain is not None, "errors are told by a domain")
        _check_errors(network.errors, network)


def _check_errors(errors: ErrorModel, network: Network) -> None:
    """Check an error model, output by output."""
    outputs, domain = len(network.modelled), network.domain
    variables = 0 if domain is None else len(domain.features) + len(domain.inputs) + 3
    shape = errors.knots.shape
    _require(
        shape[:2] == (outputs, variables) and shape[2:] >= (2,), "knots of the errors"
    )
    _require(errors.height.shape == shape, "heights of the errors")
    _require(errors.constant.shape == (outputs,), "sizes of the errors")
    _require(
        errors.quantile.shape == (outputs, len(STORED_PROBABILITIES)),
        "quantiles of the errors",
    )
    _require(np.all(np.diff(errors.knots) > 0), "knots of the errors do not rise")
    _require(
        np.all(np.asarray(errors.quantile) >= 0)
        and np.all(np.diff(errors.quantile) >= 0),
        "quantiles of the errors do not rise",
    )


def _check_domain(domain: Domain) -> None:
    """Check a domain, feature by feature and input by input."""
    own, used = (len(domain.features),), (len(domain.inputs),)
    shapes = {
        **dict.fromkeys(("middle", "spread", "weight"), own),
        **dict.fromkeys(("low", "high", "rate"), used),
        "points": (len(domain.points), *own),
        "whiten": own * 2,
        "border": (len(LAYERS),),
    }
    for name, shape in shapes.items():
        _require(getattr(domain, name).shape == shape, f"the domain's {name}")
    sizes = np.concatenate([domain.spread, domain.border])
    _require(len(domain.points) and np.all(sizes > 0), "the domain has no size")
    first = tuple((s, 0) for s in domain.inputs)
    _require(
        domain.features.rows[: used[0]] == first
        and not any(domain.features.filters[: used[0]]),
        "the domain's features do not begin with its inputs",
    )


def _check_magnitudes(network: Network) -> None:
    """Numbers that a run multiplies and divides by stay within those there are."""
    arrays = network.gain, network.low, network.high, network.lower, network.upper
    gain, low, high, lower, upper = map(np.asarray, arrays)
    with np.errstate(all="ignore"):
        sizes = [1 / gain, high - low, (upper - lower) * gain[list(network.signals)]]
        sizes += [1 / np.asarray(m.span) for m in network.models]
    _require(
        all(np.all(np.isfinite(size)) for size in sizes)
        and np.all(lower <= upper)
        and np.all(low <= high),
        "a gain, range or bound is beyond all measurements",
    )


def _check_model(model: OutputModel, limit: int) -> None:
    """One output's model; terms are rows of indices below `limit`."""
    local, dims = model.local, (len(model.scheduling),)
    models = model.active.shape
    _require(len(models) == 1, "the mask of local models is no list")
    _require(
        model.offset.shape == dims == model.span.shape, "scaling of the scheduling"
    )
    _require(np.all(np.asarray(model.span) > 0), "a scheduling range is empty")
    model.validity.check(models[0], dims[0])
    _check_groups(model)
    _require(np.any(np.asarray(model.active)), "no local model is active")
    _require(
        local.index.shape == local.used.shape == local.coefficient.shape,
        "coefficients, indices and masks differ in shape",
    )
    _require(local.index.shape[:1] == models, "local models and validities differ")
    _require(local.index.ndim == local.factor.ndim == 2, "a table of terms has no rows")
    _require(1 <= local.factor.shape[1] <= LARGEST_DEGREE, "the degree of the terms")
    for table, top in ((local.factor, limit), (local.index, len(local.factor))):
        entries = np.asarray(table)
        _require(
            not entries.size or (entries.min() >= 0 and entries.max() < top),
            "a term points outside its table",
        )


def _check_groups(model: OutputModel) -> None:
    """Local models that have feedback of their own, by groups."""
    root = model.root
    if root is not None:
        shape = (0 if model.own is None else len(model.own),)
        _require(
            root.squares.shape == shape == root.floor.shape,
            "roots and kinds of feedback differ in number",
        )
    if model.own is None:
        _require(root is None, "a root is computed by a kind of feedback")
        return
    own, models = np.asarray(model.own), len(model.active)
    _require(
        own.ndim == 2 and own.shape[1] == models,
        "local models and their kinds of feedback differ in number",
    )
    _require(np.all(own.sum(axis=0) <= 1), "a local model has two kinds of feedback")
    _require(
        len(own) != models or np.array_equal(own, np.diag(np.diag(own))),
        "as many kinds of feedback as local models, and they share some",
    )
