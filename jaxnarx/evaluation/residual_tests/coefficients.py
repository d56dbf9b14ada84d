"""Coefficients with standard errors, and the samples that hold most sway over them."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.special

from jaxnarx.checks import require
from jaxnarx.data import Dataset
from jaxnarx.evaluation.residual_tests.one_step import OneStep, slots
from jaxnarx.models import Network
from jaxnarx.selection import Selection

LISTED_LEVERAGE_SAMPLES = 10
"""Samples of high leverage that are listed."""


@dataclasses.dataclass(frozen=True)
class Coefficient:
    """One coefficient of one local model (counted from 1), physical units.

    `error` is its standard error for independent noise of one variance, `t` and `p`
    test it against zero with the others in the model; None where the data do not
    determine it. `err` is its error reduction ratio, where a selection tells it.
    """

    model: int
    term: str
    value: float
    error: float | None
    t: float | None
    p: float | None
    err: float | None


@dataclasses.dataclass(frozen=True)
class Influence:
    """A sample, its leverage (0 to 1) and its residual in standard deviations.

    `distance` is Cook's (1977): how far the predictions would move without it, r^2 h/(P
    (1 - h)) with r the studentised residual; above 1 deserves a look.
    """

    record: str
    time: float
    leverage: float
    studentised: float
    distance: float


def coefficients(
    network: Network, one: OneStep, err: dict[str, float]
) -> tuple[Coefficient, ...]:
    """Every used coefficient of the output's active local models.

    Least squares give the coefficient theta an error A'e, of variance s^2 |A|^2. Where
    they were not fitted to these data, it is what fitting them here would leave.
    """
    model, residual = network.models[one.place], one.residual
    share = len(residual.at) / residual.samples
    error = residual.deviation * np.linalg.norm(one.design.answer, axis=0)
    error = error * np.sqrt(share)
    equations = network.equations()
    equations = [e for e in equations if e["output"] == one.output.name]
    unit = _units(network, one)
    known = np.isfinite(np.array(_conditions(one)))[one.owner] & (error > 0)
    # Both for scaled terms: the physical ones may be beyond every number.
    ratio = _scale_coefficients(network, one) / np.where(known, error, 1.0)
    with np.errstate(over="ignore"):
        error = error * unit
    rows = []
    terms = [(m, *term) for m, e in enumerate(equations) for term in e["terms"]]
    for n, (m, name, value) in enumerate(terms):
        own = float(error[n]) if known[n] else None
        t = float(ratio[n]) if known[n] else None
        tail = None if t is None else scipy.special.stdtr(residual.freedom, -abs(t))
        p = None if tail is None else float(2 * tail)
        number = int(equations[m]["model"])
        rows.append(Coefficient(number, name, value, own, t, p, err.get(name)))
    assert len(rows) == sum(map(len, slots(model))) == len(error)
    return tuple(rows)


def _units(network: Network, one: OneStep) -> np.ndarray:
    """The unit of every coefficient: one over the gains of its term's factors.

    Residuals have the output's unit already, up to a factor.
    """
    local = network.models[one.place].local
    gain = np.asarray(network.gain)
    scale = np.concatenate([[1.0], gain[[s for s, _ in network.variables]]])
    own = np.concatenate(slots(network.models[one.place]))
    with np.errstate(over="ignore", divide="ignore"):
        return one.unit / np.prod(scale[np.asarray(local.factor)[own]], axis=1)


def _scale_coefficients(network: Network, one: OneStep) -> np.ndarray:
    """Every coefficient, of scaled terms, in the residual's unit."""
    model = network.models[one.place]
    value, used = np.asarray(model.local.coefficient, float), model.local.used
    active = np.flatnonzero(np.asarray(model.active))
    gain = float(np.asarray(network.gain)[network.signals[one.place]])
    each = [value[m, np.asarray(used)[m]] for m in active]
    return np.concatenate(each) * (gain / one.unit)


def _conditions(one: OneStep) -> list[float]:
    """The condition of the problem that each local model takes part in."""
    models = int(one.owner.max(initial=0)) + 1
    given = list(one.design.condition)
    return given if len(given) == models else given * models


def influences(one: OneStep, data: Dataset) -> tuple[Influence, ...]:
    """The samples of highest leverage, of those at which the fit is known."""
    residual = one.residual
    h = np.minimum(one.design.leverage * residual.share, 1 - 1e-9)
    top = np.argsort(-h, kind="stable")[:LISTED_LEVERAGE_SAMPLES]
    record, row = np.divmod(residual.at[top], residual.value.shape[1])
    e = residual.value.reshape(-1)[residual.at[top]]
    count = max(one.design.parameters, 1.0)
    # Only a fit to these very samples makes residuals smaller where it is drawn in.
    shrunk = np.sqrt(1 - h[top]) if one.estimated != "no" else 1.0
    r = e / (residual.deviation * shrunk)
    distance = r**2 * h[top] / (count * (1 - h[top]))
    return tuple(
        Influence(
            str(data.records[n].name),
            float(data.sample_time * t),
            *map(float, figures),
        )
        for n, t, *figures in zip(record, row, h[top], r, distance, strict=True)
    )


def error_reduction(selection: Any, output: str) -> dict[str, float]:
    """Error reduction ratio by term: of a `Selection`, or of what a report stores."""
    if selection is None:
        return {}
    if isinstance(selection, Selection):
        if output not in selection.output_names:
            return {}
        place = selection.output_names.index(output)
        names = selection.names_of(output)
        return dict(zip(names, selection.err[place].tolist(), strict=False))
    require(
        isinstance(selection, Mapping),
        "selection",
        "selection must be a Selection, or a mapping as a Report stores it, got a "
        f"{type(selection).__name__}",
    )
    entry = selection if "names" in selection else selection.get(output, {})
    pairs = zip(entry.get("names", ()), entry.get("err", ()), strict=False)
    return {str(name): float(value) for name, value in pairs if value is not None}
