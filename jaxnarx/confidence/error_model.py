"""Sizes of the errors of a network's free run, learnt from records left out."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.confidence.domain_fit import InputRows, feature_rows, fold_layers
from jaxnarx.data import Dataset, Groups
from jaxnarx.data import groups as make_groups
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import GROWTH_EXPONENT, STORED_PROBABILITIES, ErrorModel, Network
from jaxnarx.simulation import Trajectories, match_records, simulate

KNOTS_PER_VARIABLE = 6
"""Knots of every variable, at quantiles of the records."""
LEAST_ERROR_SHARE = 0.05
"""Errors below this share of their root mean square count as that."""
RIDGES_TRIED = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)
"""Pull of heights to zero, in shares of what a sample says, that are tried."""
FEWEST_ERRORS = 200
"""Errors below which nothing is learnt."""


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorRows:
    """The variables of the error model at the samples of `rows`, for one output."""

    z: Float[np.ndarray, "variables time"]
    error: Float[np.ndarray, " time"]
    group: Int[np.ndarray, " time"]


@guard_arguments
def fit_error_model(
    network: Network,
    data: Dataset,
    *,
    groups: Groups | None = None,
    left_out: Float[np.ndarray, "outputs groups"] | None = None,
    run: Trajectories | None = None,
) -> Network:
    """The network with prediction intervals of its free run.

    Args:
        network: A network with a domain.
        data: Records that took no part in its training. Or those of the training, with
            `left_out`.
        groups: Groups of records of `data` (`jaxnarx.data.groups`); by default those
            that the records state, else detected ones.
        left_out: Free-run RMSE, in the output's unit, of every group by a model made
            without it, as a search has found it: errors of the training are that many
            times larger in use. NaN where it is not known.
        run: The free run of `data` where it is at hand, or that of networks of the same
            structure, of every engine its own, say.

    Returns:
        The network with `errors` (`jaxnarx.models.ErrorModel`), a free run unchanged;
        without them where fewer than 200 samples of an output count.

    Example:
        known = jnx.confidence.fit_domain(network, data)
        known = jnx.confidence.fit_error_model(known, data)
        print(jnx.intervals(known, data).value.lower[0].shape)
    """
    if network.domain is None:
        raise SpecError(
            "the network has no domain: jnx.confidence.fit_domain(network, data) fits "
            "one to the records of its training",
            field="network",
        )
    data = match_records(network, data)
    if groups is None:
        groups = _groups(network, data)
    run = simulate(network, data).value if run is None else run
    rows = feature_rows(network.domain.features, data, groups)
    layers = fold_layers(network.domain, rows)
    index = layers.max(axis=1)
    found = []
    for o in range(len(network.modelled)):
        own = _rows(network, data, run, rows, index, o)
        if left_out is not None:
            own = _scale_to_held_out(own, left_out[o])
        if len(own.error) < FEWEST_ERRORS or not own.error.max() > 0:
            return dataclasses.replace(network, errors=None)
        # Channels in extreme units may overflow.
        with np.errstate(all="ignore"):
            found.append(_learnt(own))
    kind = network.gain.dtype
    leaves = [np.stack([f[k] for f in found]).astype(kind) for k in range(4)]
    if not all(np.all(np.isfinite(leaf)) for leaf in leaves):
        return dataclasses.replace(network, errors=None)
    return dataclasses.replace(network, errors=ErrorModel(*jax.device_put(leaves)))


def _groups(network: Network, data: Dataset) -> Groups | None:
    """Groups that are left out together, if there is more than one."""
    try:
        return make_groups(data, gap=network.before)
    except DataError:
        return None


def error_variables_at(
    run: Trajectories,
    rows: InputRows,
    index: Float[np.ndarray, " time"],
    output: int,
) -> Float[np.ndarray, "variables time"]:
    """The variables of the error model, at the samples of `rows`."""
    y = [one[:, output] for one in run.computed]
    step = [np.abs(np.diff(one, prepend=one[:1])) for one in y]
    own = np.stack([np.concatenate(y), np.concatenate(step)])[:, rows.at_sample]
    return error_variables(rows.x, own, index)


def error_variables(
    x: Float[np.ndarray, "features time"],
    own: Float[np.ndarray, "two time"],
    index: Float[np.ndarray, " time"],
) -> Float[np.ndarray, "variables time"]:
    """The same from the features, the run and its steps, and the index."""
    used = len(x) // 2
    apart = np.abs(x[:used] - x[used:])
    return np.concatenate([x, apart, own, index[None]])


def _rows(network, data, run, rows, index, output) -> ErrorRows:
    """Scored samples of records that did not diverge."""
    o = network.modelled[output]
    pairs = zip(data, run.computed, strict=True)
    error = np.concatenate([r.y[:, o] - y[:, output] for r, y in pairs])
    counted = [
        s[:, output] & ~d[output] for s, d in zip(run.scored, run.diverged, strict=True)
    ]
    z = error_variables_at(run, rows, index, output)
    good = np.concatenate(counted)[rows.at_sample]
    error = np.abs(error)[rows.at_sample]
    return ErrorRows(z[:, good], error[good], rows.group[good])


def _scale_to_held_out(
    rows: ErrorRows, rmse: Float[np.ndarray, " groups"]
) -> ErrorRows:
    """Errors of the training as large as those of groups left out."""
    factor = np.full(len(rmse), np.nan)
    for g in range(len(rmse)):
        own = rows.error[rows.group == g]
        if len(own) and np.any(own > 0):
            factor[g] = rmse[g] / _rms(own)
    factor = np.maximum(factor, 1.0)
    usual = np.nanmedian(factor) if np.any(np.isfinite(factor)) else 1.0
    factor = np.where(np.isfinite(factor), factor, usual)
    times = np.append(factor, usual)[rows.group]
    return dataclasses.replace(rows, error=rows.error * times)


def _learnt(rows: ErrorRows) -> tuple:
    """Knots, heights, constant and quantiles of one output.

    The logarithm of the error is fitted by ridge regression; every group's errors are
    then measured by the fit without it. Records to come are to the mean of G groups as
    far as sqrt(1 + 1/G) of what these are from one another.
    """
    knots = np.stack([_knots(z) for z in rows.z])
    hats = np.concatenate([_hats(z, k) for z, k in zip(rows.z, knots, strict=True)])
    hats = np.concatenate([np.ones((1, hats.shape[1])), hats])
    floor = LEAST_ERROR_SHARE * _rms(rows.error)
    y = np.log(np.maximum(rows.error, floor)) - _log_growth(rows.z)
    labels = [g for g in np.unique(rows.group) if g >= 0]
    parts = [_normal(hats[:, rows.group == g], y[rows.group == g]) for g in labels]
    if len(parts) < 2:
        parts, labels = [_normal(hats, y)], []
    whole = sum(part[0] for part in parts), sum(part[1] for part in parts)
    ridge = RIDGES_TRIED[-1]
    if labels:
        ridge = min(RIDGES_TRIED, key=lambda r: _cross_validate(parts, whole, r))
    theta = _solve(*whole, ridge)
    relative, weight = [], []
    for g, (a, b, *_) in zip(labels, parts, strict=True) if labels else ():
        own = rows.group == g
        fold = _solve(whole[0] - a, whole[1] - b, ridge)
        size = np.exp(fold @ hats[:, own] + _log_growth(rows.z[:, own]))
        relative.append(rows.error[own] / size)
        weight.append(np.full(own.sum(), 1.0 / own.sum()))
    if not labels:
        relative = [rows.error / np.exp(theta @ hats + _log_growth(rows.z))]
        weight = [np.ones(len(rows.error))]
    quantile = _quantiles(np.concatenate(relative), np.concatenate(weight))
    quantile = quantile * np.sqrt(1 + 1 / max(len(labels), 1))
    return knots, theta[1:].reshape(knots.shape), theta[0], quantile


def _rms(error: Float[np.ndarray, " time"]) -> float:
    """Root mean square of numbers of any size."""
    most = float(error.max())
    return most * float(np.sqrt(np.mean((error / most) ** 2)))


def _log_growth(z: Float[np.ndarray, "variables time"]) -> Float[np.ndarray, " time"]:
    """Logarithm of what the index beyond the border adds."""
    return GROWTH_EXPONENT * np.log(np.maximum(z[-1], 1.0))


def _knots(z: Float[np.ndarray, " time"]) -> Float[np.ndarray, " knots"]:
    """At quantiles, apart from one another."""
    knots = np.quantile(z, np.linspace(0.01, 0.99, KNOTS_PER_VARIABLE))
    least = 1e-6 * max(float(np.abs(z).max()), 1e-300)
    return knots + least * np.arange(KNOTS_PER_VARIABLE)


def _hats(
    z: Float[np.ndarray, " time"], knots: Float[np.ndarray, " knots"]
) -> Float[np.ndarray, "knots time"]:
    """Hat functions, constant beyond the ends."""
    return np.stack([np.interp(z, knots, one) for one in np.eye(len(knots))])


def _normal(hats, y):
    return hats @ hats.T, hats @ y, float(y @ y), len(y)


def _solve(a, b, ridge):
    """Ridge regression, its constant free; in shares of what the samples say."""
    pull = ridge * a[0, 0] * np.eye(len(a)) / KNOTS_PER_VARIABLE
    pull[0, 0] = 0.0
    return np.linalg.solve(a + pull + 1e-12 * a[0, 0] * np.eye(len(a)), b)


def _cross_validate(parts, whole, ridge) -> float:
    """Mean over groups of the squared error of the logarithm without them."""
    total = 0.0
    for a, b, square, count in parts:
        theta = _solve(whole[0] - a, whole[1] - b, ridge)
        total += (square - 2 * theta @ b + theta @ a @ theta) / count
    return total


def _quantiles(
    relative: Float[np.ndarray, " time"], weight: Float[np.ndarray, " time"]
) -> Float[np.ndarray, " levels"]:
    """Quantiles of errors in units of their expected size, every group as much as any
    other."""
    order = np.argsort(relative)
    share = np.cumsum(weight[order]) / weight.sum()
    at = np.searchsorted(share, STORED_PROBABILITIES).clip(max=len(order) - 1)
    return relative[order][at]
