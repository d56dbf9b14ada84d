"""Extended least squares: noise terms beside any model linear in its parameters.

    y(t) = sum_k theta_k p_k(t) + c_1 e(t - 1) + ... + c_nc e(t - nc) + e(t)

The residuals of one fit are the e of the next, until the coefficients settle. Without
the noise terms coloured noise biases the coefficients of lagged outputs. It converges
where 1/C(q) - 1/2 is positive real (Ljung 1977), so not for every C.

Reference: S. A. Billings, Nonlinear System Identification, Wiley 2013, chapter 3.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset, gains
from jaxnarx.errors import SpecError
from jaxnarx.linear.fit import WORST_CONDITION
from jaxnarx.linear.orders import output_place
from jaxnarx.linear.triangle import factorise
from jaxnarx.models import Network, assemble, global_model
from jaxnarx.regressors import Pool, Rows, evaluate, regression_rows
from jaxnarx.selection import Selection
from jaxnarx.solution import RESULTS, Solution


@dataclasses.dataclass(frozen=True, eq=False)
class ExtendedFit:
    """A network of the terms, and the noise terms beside it.

    `network` is the part without noise terms: what the free run needs. `coefficient`
    and `error` (standard errors, of the last regression) are those of `terms` in
    physical units; `noise[k]` belongs to e(t - 1 - k), `noise_error` likewise.
    `residual` holds e of every record [unit of the output], zero where a window is
    incomplete.
    """

    network: Network
    terms: tuple[str, ...]
    coefficient: Float[np.ndarray, " terms"]
    error: Float[np.ndarray, " terms"]
    noise: Float[np.ndarray, " lags"]
    noise_error: Float[np.ndarray, " lags"]
    noise_variance: float
    residual: tuple[Float[np.ndarray, " _"], ...]


@guard_arguments
def extended_least_squares(
    terms: Pool | Selection,
    data: Dataset,
    *,
    residual_lags: int,
    output: str | None = None,
    max_rounds: int = 100,
    tolerance: float | int = 1e-6,
) -> Solution[ExtendedFit]:
    """Fit all terms of a pool, or those a selection chose, with noise terms.

    `residual_lags` is nc. Residuals before the first complete window of a record are
    zero. Status `ok` when no coefficient moves by more than `tolerance` of its standard
    error, `budget_spent` after `max_rounds` (the round with the least sum of squares is
    returned), `unidentifiable` where terms cannot be told apart. `stats["history"]`
    holds the sums of squares (physical units) of every round; the first is that of
    least squares without noise terms.
    """
    if residual_lags < 0 or max_rounds < 1:
        raise SpecError(
            f"residual_lags must be 0 or more and max_rounds 1 or more, got "
            f"{residual_lags} and {max_rounds}",
            field="residual_lags",
        )
    pool = _pool(terms, data, output)
    place = pool.outputs[0]
    need = len(pool) + residual_lags + 1
    rows = regression_rows(
        data,
        pool.variables,
        pool.outputs,
        history=pool.variables.longest,
        need=need,
        exact=True,
    )
    design = np.asarray(evaluate(pool.factor, rows.v), float)
    found = _iterate(design, rows, residual_lags, max_rounds, tolerance)
    unit = float(rows.gain[len(data.channels.inputs) + place])
    value = _value(found, pool, data, rows, unit)
    stats = {
        "history": [float(s) * unit**2 for s in found.history],
        "rounds": len(found.history) - 1,
        "cond": found.condition,
        "samples": design.shape[1],
    }
    status, detail = found.status, ""
    if found.condition > WORST_CONDITION:
        status = RESULTS.unidentifiable
        names = [*value.terms, *(f"e[t-{k + 1}]" for k in range(residual_lags))]
        detail = "the data do not tell " + ", ".join(names[n] for n in found.weak)
        detail += " apart"
    return Solution(value, status, stats, detail)


def _pool(terms: Pool | Selection, data: Dataset, output: str | None) -> Pool:
    """The terms of one output, the selection's own in order of choice."""
    pool = terms.pool if isinstance(terms, Selection) else terms
    names = [pool.channels.output_names[o] for o in pool.outputs]
    if output is None and len(names) > 1:
        raise SpecError(f"name one of the outputs {names}", field="output")
    chosen = output_place(data, output or names[0])
    if chosen not in pool.outputs:
        raise SpecError(f"{output!r} is not among {names}", field="output")
    place = pool.outputs.index(chosen)
    factor = pool.factor
    if isinstance(terms, Selection):
        factor = factor[terms.terms(place)]
    return Pool(pool.variables, factor, pool.channels, (chosen,))


@dataclasses.dataclass(frozen=True)
class _Round:
    theta: np.ndarray
    inverse: np.ndarray
    sse: float
    residual: np.ndarray
    condition: float
    weak: tuple[int, ...]
    history: tuple[float, ...]
    status: RESULTS


def _iterate(design, rows: Rows, lags: int, rounds: int, tolerance) -> _Round:
    """Regress, take the residuals, and again; in scaled units."""
    y = np.asarray(rows.y, float)[0]
    terms = len(design)
    past = _Past(rows, lags)
    best = now = _solve(np.concatenate([design, past(np.zeros_like(y))]), y, terms)
    history = [now.sse]
    status = RESULTS.ok if not lags else RESULTS.budget_spent
    for _ in range(rounds if lags else 0):
        before = now
        now = _solve(np.concatenate([design, past(before.residual)]), y, terms + lags)
        history.append(now.sse)
        best = now if now.sse <= best.sse or len(history) == 2 else best
        spread = np.sqrt(now.sse / len(y) * np.maximum(np.diagonal(now.inverse), 0.0))
        if np.all(np.abs(now.theta - before.theta) <= tolerance * spread):
            best, status = now, RESULTS.ok
            break
    return dataclasses.replace(best, history=tuple(history), status=status)


def _solve(columns: np.ndarray, y: np.ndarray, use: int) -> _Round:
    """Least squares by the first `use` columns; the others have coefficient zero."""
    table = factorise(np.concatenate([columns, y[None]]), constant=False)
    fit = table.solve(range(use))
    theta = np.zeros(len(columns))
    theta[:use] = fit.theta
    inverse = np.zeros((len(columns), len(columns)))
    inverse[:use, :use] = fit.inverse
    residual = y - theta @ columns
    weak = fit.weak
    return _Round(
        theta, inverse, fit.sse, residual, fit.condition, weak, (), RESULTS.ok
    )


class _Past:
    """Lagged residuals of regression rows, zero outside their record's rows."""

    def __init__(self, rows: Rows, lags: int):
        _, self.time, _ = rows.batch.signals.shape
        self.at, self.lags = rows.at, lags
        self.size = rows.batch.valid.shape[0] * self.time

    def flat(self, e: np.ndarray) -> np.ndarray:
        """Residuals at their places of the padded records."""
        out = np.zeros(self.size)
        out[self.at] = e
        return out

    def __call__(self, e: np.ndarray) -> Float[np.ndarray, "lags rows"]:
        flat, own = self.flat(e), self.at % self.time
        columns = [
            np.where(own >= k, flat[np.maximum(self.at - k, 0)], 0.0)
            for k in range(1, self.lags + 1)
        ]
        return np.stack(columns) if columns else np.zeros((0, len(e)))


def _value(found: _Round, pool: Pool, data: Dataset, rows: Rows, unit: float):
    terms, count = len(pool), len(found.theta)
    gain = gains(data)
    theta = found.theta[:terms].astype(gain.dtype)
    network = assemble(pool, data, gain, [global_model(pool.factor, theta)])
    signal = [s for s, _ in pool.variables]
    scale = np.concatenate([[1.0], gain[signal]])
    to_unit = unit / np.prod(scale[pool.factor], axis=1)
    variance = found.sse / (len(found.residual) - count)
    spread = np.sqrt(variance * np.maximum(np.diagonal(found.inverse), 0.0))
    flat = _Past(rows, 0).flat(found.residual * unit).reshape(len(data), -1)
    return ExtendedFit(
        network,
        tuple(pool.names),
        found.theta[:terms] * to_unit,
        spread[:terms] * to_unit,
        found.theta[terms:],
        spread[terms:],
        variance * unit**2,
        tuple(flat[n, : len(r)] for n, r in enumerate(data)),
    )
