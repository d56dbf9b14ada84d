"""Fit a linear model: least squares where that is all, else prediction error."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Batch, Dataset, stack_records
from jaxnarx.errors import DataError
from jaxnarx.linear.model import LinearModel
from jaxnarx.linear.orders import output_place, require_varying
from jaxnarx.linear.prediction_error import PredictionErrorEnd, least_innovations
from jaxnarx.linear.recursion import Signals, signals, window_start
from jaxnarx.linear.starts import starts
from jaxnarx.linear.structure import Structure, make_structure
from jaxnarx.linear.triangle import triangle
from jaxnarx.models import ranges
from jaxnarx.regressors import require_samples
from jaxnarx.settings import LinearMethod
from jaxnarx.solution import RESULTS, Solution


@dataclasses.dataclass(frozen=True, eq=False)
class ColumnScale:
    """(x - mean) / spread of the inputs in use and, last, the output.

    Without a constant term the means are zero: the data are deviations as they are. A
    signal that rests at its mean has infinite spread: scaled it is zero, where rounding
    would be fitted, and its coefficients are zero too.
    """

    mean: Float[np.ndarray, " signals"]
    spread: Float[np.ndarray, " signals"]

    @classmethod
    def of(cls, data: Signals, valid: np.ndarray, *, constant: bool) -> "ColumnScale":
        """Scales from the valid samples of all records."""
        every = np.concatenate([data.u, np.asarray(data.y)[..., None]], axis=2)[valid]
        mean = every.mean(axis=0) if constant else np.zeros(every.shape[1])
        spread = np.sqrt(np.mean((every - mean[None]) ** 2, axis=0))
        still = spread <= 1e-12 * np.abs(every).max(axis=0, initial=0.0)
        return cls(mean, np.where(still, np.inf, spread))

    def apply(self, data: Signals) -> Signals:
        """The scaled signals."""
        u = (data.u - self.mean[None, None, :-1]) / self.spread[None, None, :-1]
        y = (data.y - self.mean[-1]) / self.spread[-1]
        return Signals(jnp.asarray(u), jnp.asarray(y), data.known)

    def physical(
        self,
        structure: Structure,
        parameters: Float[np.ndarray, " params"],
        covariance: Float[np.ndarray, "params params"],
    ) -> tuple[Float[np.ndarray, " params"], Float[np.ndarray, "params params"]]:
        """Parameters and covariance in physical units.

        b_i by the ratio of spreads; the constant takes up the means, constant' = s_y
        constant + A(1) mean_y - sum_i B_i(1)/F_i(1) mean_i. The covariance follows by
        the derivative of this map.
        """
        value, slope = _map_parameters(
            structure,
            jnp.asarray(parameters),
            jnp.asarray(self.mean),
            jnp.asarray(self.spread),
        )
        slope = np.asarray(slope)
        return np.asarray(value), slope @ covariance @ slope.T


@eqx.filter_jit
def _map_parameters(structure: Structure, parameters, mean, spread):
    def physical(theta):
        p = structure.split(theta)
        b = tuple(x * spread[-1] / spread[i] for i, x in enumerate(p.b))
        offset = spread[-1] * p.constant + jnp.sum(p.a) * mean[-1]
        for i, f in enumerate(p.f):
            offset = offset - jnp.sum(b[i]) / jnp.sum(f) * mean[i]
        new = structure.join(p._replace(b=b, constant=offset))
        return new, new

    slope, value = jax.jacfwd(physical, has_aux=True)(parameters)
    return value, slope


WORST_CONDITION = 1 / np.sqrt(np.finfo(float).eps)
"""Condition of the unit-norm columns, or of the information, from which on parameters
are not told apart."""


@guard_arguments
def fit_linear(
    data: Dataset, method: LinearMethod, *, output: str | None = None
) -> Solution[LinearModel]:
    """Fit a linear model (2.3) to all records together.

    Windows never cross a record's border; samples whose window holds a missing one are
    not scored. The constant term stands for the operating point, see
    `jaxnarx.settings.linear`.

    FIR and ARX are solved by one QR factorisation. The others minimise the squared
    innovations (`prediction_error`), with the initial states of B/F of every record as
    further parameters. Standard errors hold if the noise model is right: those of an
    output-error fit under coloured noise are too small.

    Status `unidentifiable` where columns are dependent (a constant input, say) or
    nearly so; `detail` names the group. Parameters are then those of smallest norm from
    least squares, any of the best ones from a search. `budget_spent`, `stalled` as
    elsewhere. An unstable model is no failure of the fit:
    `detail` says so, `simulate` will report `diverged`. Fewer usable samples than
    parameters, a delay beyond the records, and a constant output raise `DataError`.

    Args:
        data: The records.
        method: `FIR`, `ARX`, `ARMAX`, `OutputError`, `BoxJenkins`, or all polynomials
            together, `GeneralLinear`.
        output: Name of the output where there are several; others take no part.

    Returns:
        `value` is the model. `stats`: `loss` (sum of squared innovations, physical
        units), `samples`, `parameters`, `fit` (4.43, one step ahead, per cent), `cond`,
        `rank`, `steps`, `pole`, the largest modulus of the model's poles, and after a
        search `initial`, the states of every record as deviations from the mean.
    """
    place = output_place(data, output)
    structure = make_structure(method, data.channels)
    if structure.is_linear:
        return _least_squares(data, structure, place)
    return _search_orders(data, structure, place, method)


def _least_squares(data: Dataset, structure: Structure, output: int) -> Solution:
    own = len(data.channels.inputs) + output
    rows = [(own, k) for k in range(1, structure.na + 1)]
    for i, signal in enumerate(structure.inputs):
        rows += [(signal, k) for k in structure.input_lags(i)]
    table = triangle(
        data,
        output,
        rows,
        history=structure.longest,
        constant=structure.constant,
        need=structure.size + 1,
    )
    require_varying(table, data.channels.output_names[output])
    use = range(len(rows))
    fit = table.solve(use)
    variance = fit.sse / (table.samples - structure.size)
    theta, inverse = _with_constant(table, fit, structure)
    # The regression has -a on the past outputs.
    sign = np.where(np.arange(structure.size) < structure.na, -1.0, 1.0)
    model = _model(
        data, structure, output, sign * theta, variance * inverse * np.outer(sign, sign)
    )
    stats = {
        "cond": fit.condition,
        "rank": fit.rank + int(structure.constant),
        "steps": 0,
    }
    weak = ()
    if fit.condition > WORST_CONDITION:
        names = structure.names(data.channels.input_names)
        weak = tuple(names[n] for n in fit.weak)
    figures = (fit.sse, table.samples, table.total)
    return _solution(model, variance, RESULTS.ok, stats, weak, figures)


def _with_constant(table, fit, structure: Structure):
    """Coefficients and (X'X)^-1 with the constant behind them."""
    if not structure.constant:
        return fit.theta, fit.inverse
    use = range(len(fit.theta))
    mean = table.mean[:-1]
    across = -fit.inverse @ mean
    corner = 1 / table.samples + mean @ fit.inverse @ mean
    inverse = np.block([[fit.inverse, across[:, None]], [across[None], corner]])
    return np.append(fit.theta, table.intercept(use, fit.theta)), inverse


def _search_orders(
    data: Dataset, structure: Structure, output: int, method
) -> Solution:
    batch, inputs = stack_records(data), len(data.channels.inputs)
    whole = signals(structure, batch, inputs, output)
    known = np.asarray(whole.known)
    count = structure.size + int(np.any(known, axis=1).sum()) * sum(structure.nf)
    require_samples(
        data, known[..., None], history=window_start(structure), need=count + 1
    )
    valid = _valid(structure, batch, inputs + output)
    scale = ColumnScale.of(whole, valid, constant=structure.constant)
    scaled = scale.apply(whole)
    _require_motion(np.asarray(scaled.y)[valid], data, output)
    begin = starts(structure, np.asarray(scaled.u), np.asarray(scaled.y), valid)
    found = least_innovations(
        structure,
        begin,
        scaled,
        max_steps=method.max_steps,
        tolerance=method.tolerance,
    )
    model, variance, stats, weak = _physical(data, structure, output, found, scale)
    unit = float(scale.spread[-1]) ** 2
    y = np.asarray(whole.y)[known]
    total = float(np.sum((y - y.mean() * structure.constant) ** 2))
    figures = (found.loss * unit, found.samples, total)
    return _solution(model, variance, found.status, stats, weak, figures)


def _physical(
    data,
    structure: Structure,
    output: int,
    found: PredictionErrorEnd,
    scale: ColumnScale,
):
    """The model in physical units, and what its information says."""
    size = np.sqrt(np.diagonal(found.information))
    unit = np.where(size > 0, size, 1.0)
    scaled = found.information / np.outer(unit, unit)
    value, vector = np.linalg.eigh(scaled)
    cut = value.max() * np.finfo(float).eps * len(value)
    keep = value > cut
    inverse = np.where(keep, 1 / np.where(keep, value, 1.0), 0.0)
    covariance = (vector * inverse[None]) @ vector.T / np.outer(unit, unit)
    variance = found.loss / max(found.freedom, 1)
    theta, covariance = scale.physical(
        structure, found.parameters, variance * covariance
    )
    condition = float(np.sqrt(value[-1] / value[0])) if keep.all() else float("inf")
    weak = ()
    if condition > WORST_CONDITION:
        names = structure.names(data.channels.input_names)
        weak = tuple(names[int(n)] for n in np.flatnonzero(np.abs(vector[:, 0]) > 0.2))
    model = _model(data, structure, output, theta, covariance)
    stats = {"cond": condition, "rank": int(keep.sum()), "steps": found.steps}
    stats["initial"] = found.initial * float(scale.spread[-1])
    return model, variance * float(scale.spread[-1]) ** 2, stats, weak


def _valid(structure: Structure, batch: Batch, own: int) -> np.ndarray:
    """The samples at which all signals in use are measured."""
    return np.all(batch.valid[:, :, [*structure.inputs, own]], axis=2)


def _require_motion(y: np.ndarray, data: Dataset, output: int) -> None:
    if np.all(y == y[:1]):
        name = data.channels.output_names[output]
        raise DataError(
            f"{name} is constant over all usable samples: there is nothing to model",
            channel=name,
        )


def _model(
    data: Dataset,
    structure: Structure,
    output: int,
    theta: np.ndarray,
    covariance: np.ndarray,
) -> LinearModel:
    low, high = ranges(data)
    dtype = low.dtype
    return LinearModel(
        structure,
        data.channels,
        output,
        jnp.asarray(theta, dtype),
        jnp.asarray(covariance, dtype),
        jnp.zeros((), dtype),
        jnp.asarray(data.sample_time, dtype),
        jnp.asarray(low),
        jnp.asarray(high),
    )


def _solution(model: LinearModel, variance, status, stats, weak, figures) -> Solution:
    loss, samples, total = figures
    noise = jnp.asarray(variance, model.parameters.dtype)
    model = eqx.tree_at(lambda m: m.noise_variance, model, noise)
    pole = float(np.abs(model.poles).max(initial=0.0))
    stats = stats | {
        "loss": float(loss),
        "samples": samples,
        "parameters": model.structure.size,
        "fit": 100 * (1 - float(np.sqrt(loss / total))) if total > 0 else 0.0,
        "pole": pole,
    }
    notes = []
    if weak and status in (RESULTS.ok, RESULTS.budget_spent, RESULTS.stalled):
        status = RESULTS.unidentifiable
        notes.append(f"the data do not tell {', '.join(weak)} apart")
    if pole >= 1:
        notes.append(
            f"the model is unstable (largest pole modulus {pole:.6g}); simulate will "
            "diverge"
        )
    return Solution(model, status, stats, "; ".join(notes))
