"""Slow, obvious NumPy versions of the kernels; what the tests call right.

Everything is float64 and written from the equations, one sample, one term, one model at
a time where that is clearer. Nothing here imports jaxnarx.

Conventions shared by all functions:

* a lagged variable is a pair `(signal, lag)`, meaning `signals[t - lag, signal]`;
* a term is a row of indices into `[1, x_1, ..., x_V]`, multiplied together;
* min-max scaling is `(value - offset) / gain`, gain scaling is `value / gain`.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

Table = Sequence[tuple[int, int]]
"""Rows `(signal, lag)`."""


# ------------------------------------------------------------------- lags and terms


def max_lag(table: Table) -> int:
    """The largest lag in the table, 0 for an empty one."""
    return max((lag for _, lag in table), default=0)


def lagged(
    signals: Float[np.ndarray, "time signals"], table: Table
) -> tuple[Float[np.ndarray, "time vars"], Bool[np.ndarray, " time"]]:
    """Lagged variables x_v(t) = s_signal(t - lag) of one record.

    Entries that would reach before the record are zero. `usable` is false where
    t < the largest lag of the whole table, for every variable alike.
    """
    time = len(signals)
    x = np.zeros((time, len(table)))
    for v, (signal, lag) in enumerate(table):
        for t in range(lag, time):
            x[t, v] = signals[t - lag, signal]
    return x, np.arange(time) >= max_lag(table)


def term_matrix(
    x: Float[np.ndarray, "time vars"], factor: Int[np.ndarray, "terms degree"]
) -> Float[np.ndarray, "time terms"]:
    """Products of the factors of every term; index 0 is the constant one."""
    v = np.column_stack([np.ones(len(x)), x])
    terms = np.ones((len(x), len(factor)))
    for m, row in enumerate(factor):
        for index in row:
            terms[:, m] *= v[:, index]
    return terms


def full_pool(variables: int, degree: int) -> Int[np.ndarray, "terms degree"]:
    """All monomials up to `degree`, as sorted rows in lexicographic order.

    Row 0 is the constant (0, ..., 0). There are C(variables + degree, degree) rows.
    """
    rows = itertools.combinations_with_replacement(range(variables + 1), degree)
    return np.array(list(rows), dtype=int)


# ------------------------------------------------------------------- term selection


class ForwardOLS(NamedTuple):
    """What `forward_ols_dense` returns; `steps` may be fewer than asked for."""

    indices: Int[np.ndarray, " steps"]
    err: Float[np.ndarray, " steps"]
    coefficients: Float[np.ndarray, " steps"]
    gaps: Float[np.ndarray, " steps"]


def forward_ols_dense(
    p: Float[np.ndarray, "time terms"],
    y: Float[np.ndarray, " time"],
    k: int,
    weights: Float[np.ndarray, " time"] | None = None,
    tau: float = 1e-10,
) -> ForwardOLS:
    """Forward orthogonal least squares with the error reduction ratio, dense.

    QR by Householder reflections, the pivot being the candidate of largest

        ERR_j = <r_j, b>^2 / (<r_j, r_j> <y, y>),

    r_j and b the parts of column j and of y not yet reflected away (rows i, i+1, ...
    after i steps). y is not centred and no constant is added. All products carry the
    weights: rows are multiplied by sqrt(weights), and a row of weight zero is dropped,
    whatever it holds. A candidate with <r_j, r_j> <= tau <p_j, p_j> is passed over; the
    search ends early when none is left. Equal scores: the lowest index.

    Returns, in order of choice, the indices; their ERR; the least squares coefficients
    on the chosen columns; and per step the best score minus the second best (inf with
    one candidate), so that a test can skip ties.

    Chen, Billings, Luo 1989, Int. J. Control 50(5); thesis (5.25), (5.26).
    """
    w = np.ones(len(y)) if weights is None else np.asarray(weights, float)
    keep = w > 0
    root = np.sqrt(w[keep])
    columns = p[keep] * root[:, None]
    target = y[keep] * root
    start = np.sum(columns**2, axis=0)
    energy = np.sum(target**2)

    a, b = columns.copy(), target.copy()
    chosen: list[int] = []
    err: list[float] = []
    gaps: list[float] = []
    for i in range(min(k, len(target))):
        scores: dict[int, float] = {}
        for j in range(a.shape[1]):
            left = np.sum(a[i:, j] ** 2)
            if j not in chosen and left > tau * start[j]:
                top = np.dot(a[i:, j], b[i:]) ** 2
                scores[j] = float(top / (left * energy)) if energy > 0 else 0.0
        if not scores:
            break
        best = max(scores, key=lambda j: scores[j])
        others = [score for j, score in scores.items() if j != best]
        chosen.append(best)
        err.append(scores[best])
        gaps.append(scores[best] - max(others) if others else np.inf)
        # Reflect so that the chosen column's remainder lies along row i.
        mirror = a[i:, best].copy()
        mirror[0] += np.copysign(np.linalg.norm(mirror), mirror[0])
        mirror /= np.linalg.norm(mirror)
        a[i:] -= 2 * np.outer(mirror, mirror @ a[i:])
        b[i:] -= 2 * mirror * np.dot(mirror, b[i:])

    indices = np.array(chosen, dtype=int)
    coefficients = np.linalg.lstsq(columns[:, indices], target, rcond=None)[0]
    return ForwardOLS(indices, np.array(err), coefficients, np.array(gaps))


# ---------------------------------------------------------------- validity functions


def validity(
    z: Float[np.ndarray, "time dims"],
    centre: Float[np.ndarray, "models dims"],
    width: Float[np.ndarray, "models dims"],
) -> Float[np.ndarray, "time models"]:
    """Normalised Gaussians phi_m = mu_m / sum mu, mu_m = exp(-1/2 sum ((z - c)/s)^2).

    The largest exponent is subtracted first: the same quotient, without 0/0 far away.
    Thesis (6.5), (6.6); no factor 1/s, see the slips in THESIS.md.
    """
    exponent = np.zeros((len(z), len(centre)))
    for m in range(len(centre)):
        exponent[:, m] = -0.5 * np.sum(((z - centre[m]) / width[m]) ** 2, axis=1)
    mu = np.exp(exponent - exponent.max(axis=1, keepdims=True))
    return mu / mu.sum(axis=1, keepdims=True)


# ----------------------------------------------------------- prediction, simulation


@dataclass(frozen=True)
class OutputModel:
    """One output of a network, with a partition, variables and terms of its own.

    `models[m]` lists `(factor row, coefficient)` of local model m; the factors index
    `[1, x_1, ..., x_V]` with x the `variables`, each divided by its signal's gain.
    Scheduling variables are `(s - offset) / gain` of the *physical* signal. Bounds and
    the value they limit are physical too.
    """

    signal: int
    variables: Table
    models: Sequence[Sequence[tuple[Sequence[int], float]]]
    schedule: Table = ()
    schedule_offset: Sequence[float] = ()
    schedule_gain: Sequence[float] = ()
    centre: Float[np.ndarray, "models dims"] = field(
        default_factory=lambda: np.zeros((1, 0))
    )
    width: Float[np.ndarray, "models dims"] = field(
        default_factory=lambda: np.ones((1, 0))
    )
    lower: float = -np.inf
    upper: float = np.inf


@dataclass(frozen=True)
class Network:
    """Outputs in order, and one scaling gain for every signal, outputs included."""

    outputs: Sequence[OutputModel]
    gain: Float[np.ndarray, " signals"]

    @property
    def max_lag(self) -> int:
        """The largest lag of any variable or scheduling variable of any output."""
        return max(max(max_lag(o.variables), max_lag(o.schedule)) for o in self.outputs)


class Run(NamedTuple):
    """Simulated or predicted outputs, physical, and where the bounds cut them."""

    outputs: Float[np.ndarray, "time outputs"]
    limited: Bool[np.ndarray, "time outputs"]
    usable: Bool[np.ndarray, " time"]


def evaluate_output(
    output: OutputModel,
    signals: Float[np.ndarray, "time signals"],
    gain: Float[np.ndarray, " signals"],
    t: int,
) -> tuple[float, bool]:
    """Value of one output at time t from the signals as they stand, and if limited.

    y = gain_y sum_m phi_m(z) sum_k theta_mk p_mk(x), then clipped to the bounds.
    Limited means strictly outside before clipping.
    """
    z = np.zeros((1, len(output.schedule)))
    for d, (signal, lag) in enumerate(output.schedule):
        z[0, d] = signals[t - lag, signal] - output.schedule_offset[d]
        z[0, d] /= output.schedule_gain[d]
    phi = validity(z, output.centre, output.width)[0]

    v = [1.0]
    for signal, lag in output.variables:
        v.append(float(signals[t - lag, signal] / gain[signal]))

    scaled = 0.0
    for m, terms in enumerate(output.models):
        for factor, coefficient in terms:
            product = coefficient
            for index in factor:
                product *= v[index]
            scaled += phi[m] * product
    value = float(scaled * gain[output.signal])
    return (
        min(max(value, output.lower), output.upper),
        value < output.lower or value > output.upper,
    )


def run_from(
    signals: Float[np.ndarray, "time signals"], network: Network, start: int, stop: int
) -> tuple[Float[np.ndarray, "steps outputs"], Bool[np.ndarray, "steps outputs"]]:
    """Simulate samples start, ..., stop - 1 from measured outputs before `start`.

    Measured outputs from `start` on are overwritten with NaN first, so that none can
    be used by mistake. All outputs of a sample are computed before any is written: an
    output may not appear with lag 0.
    """
    columns = [output.signal for output in network.outputs]
    for output in network.outputs:
        for signal, lag in [*output.variables, *output.schedule]:
            if signal in columns and lag == 0:
                raise ValueError(f"expected output {signal} with lag >= 1, got lag 0")
    if start < network.max_lag:
        raise ValueError(f"expected start >= {network.max_lag}, got {start}")
    state = np.array(signals, dtype=float)
    state[start:, columns] = np.nan
    limited = np.zeros((stop - start, len(columns)), bool)
    for t in range(start, stop):
        values = []
        for o, output in enumerate(network.outputs):
            value, limited[t - start, o] = evaluate_output(
                output, state, network.gain, t
            )
            values.append(value)
        state[t, columns] = values
    return state[start:stop, columns], limited


def free_run(signals: Float[np.ndarray, "time signals"], network: Network) -> Run:
    """Simulate a record: the network runs on its own past outputs (NOE).

    The first `max_lag` samples are the measured outputs, not clipped, not limited and
    not usable. From there on every lag of an output, in terms and in scheduling
    variables, is the simulated (clipped) value; inputs are always measured.
    """
    start = network.max_lag
    columns = [output.signal for output in network.outputs]
    outputs = np.array(signals[:, columns], dtype=float)
    limited = np.zeros(outputs.shape, bool)
    outputs[start:], limited[start:] = run_from(
        signals, network, start, max(start, len(signals))
    )
    return Run(outputs, limited, np.arange(len(signals)) >= start)


def k_step(signals: Float[np.ndarray, "time signals"], network: Network, k: int) -> Run:
    """Predict y(t) from outputs measured up to t - k and inputs up to t.

    The loop restarts for every t at sample t - k + 1 and its last sample is kept, not
    clipped as nothing is computed from it; `limited` tells whether one before it was.
    k = 1 is the one-step prediction.
    Samples t < max_lag + k - 1 have no full history k steps back: they hold the
    measured outputs and are not usable.
    """
    first = network.max_lag + k - 1
    columns = [output.signal for output in network.outputs]
    outputs = np.array(signals[:, columns], dtype=float)
    limited = np.zeros(outputs.shape, bool)
    free = [replace(o, lower=-np.inf, upper=np.inf) for o in network.outputs]
    for t in range(first, len(signals)):
        state = np.array(signals, dtype=float)
        path, cut = run_from(signals, network, t - k + 1, t)
        state[t - k + 1 : t, columns] = path
        state[t:, columns] = np.nan
        outputs[t] = [evaluate_output(o, state, network.gain, t)[0] for o in free]
        limited[t] = cut.any(axis=0)
    return Run(outputs, limited, np.arange(len(signals)) >= first)


# -------------------------------------------------------------------------- LOLIMOT


class Lolimot(NamedTuple):
    """A grown model and how it grew.

    `nrmse[m - 1]` belongs to m models; `splits[m - 1] = (model, dim)` is the split that
    led from m to m + 1. `worst_gap` and `dim_gap` are, per split, the relative distance
    from the chosen to the next candidate model or dimension (inf if there was none):
    a gap near machine precision is a tie.
    """

    nrmse: Float[np.ndarray, " models"]
    lower: Float[np.ndarray, "models dims"]
    upper: Float[np.ndarray, "models dims"]
    coefficients: Float[np.ndarray, "models params"]
    splits: list[tuple[int, int]]
    worst_gap: list[float]
    dim_gap: list[float]


def box_validity(
    z: Float[np.ndarray, "time dims"],
    lower: Float[np.ndarray, "models dims"],
    upper: Float[np.ndarray, "models dims"],
    k_sigma: float,
) -> Float[np.ndarray, "time models"]:
    """Centre in the middle of each box, width k_sigma times its extension."""
    return validity(z, (lower + upper) / 2, k_sigma * (upper - lower))


def weighted_least_squares(
    x: Float[np.ndarray, "time params"],
    y: Float[np.ndarray, " time"],
    weights: Float[np.ndarray, " time"],
) -> Float[np.ndarray, " params"]:
    """Minimise sum_t w_t (y_t - x_t theta)^2; least norm if x is rank deficient."""
    root = np.sqrt(weights)
    return np.linalg.lstsq(x * root[:, None], y * root, rcond=None)[0]


def lolimot(
    z: Float[np.ndarray, "time dims"],
    y: Float[np.ndarray, " time"],
    k_sigma: float = 0.4,
    max_models: int = 8,
    regressors: Float[np.ndarray, "time params"] | None = None,
) -> Lolimot:
    """Local linear model tree: axis-orthogonal growth by halving boxes.

    z schedules; the local models are linear in `regressors`, by default [1, z]. The
    network output is sum_m phi_m(z) x theta_m. Nelles and Isermann 1996.

    Details; (G) marks those without which a published curve of DESIGN section 9 is
    missed by more than 1e-6 (u = linspace(0, 1, 15) with both end points; in two
    dimensions all 225 pairs of it):

    1. z is min-max scaled to [0, 1] on the data; the root box is [0, 1]^dims. (A
       constant column is only shifted.) An offset in the regressors makes the scaling
       of z in the consequents immaterial.
    2. Gaussians of width k_sigma * box extension in each dimension of the scaled z,
       k_sigma = 0.4 (G; 1/3 differs at 2 models), normalised over all models. The
       *difference* of upper and lower bound is meant, not half of it.
    3. Local fits are weighted least squares with weight phi_m (G): rows times
       sqrt(phi_m). Using phi_m on the rows, that is weights squared, differs at two
       models. No ridge, no threshold on phi: every sample takes part in every fit.
    4. The worst model has the largest sum_t phi_m(t) e(t)^2 (G), e being the error of
       the *network*. Not divided by sum phi (that differs at 5 models in 2-D).
    5. Every dimension of the worst box is tried, halving at the middle. The new
       phi of all models are computed; only the two children are estimated, both with
       their new phi; all others keep their coefficients (G; refitting all differs at
       three models) though their phi change through the normalisation.
    6. The dimension of the smallest total squared error of the network output wins,
       whether or not it is smaller than before the split.
    7. A dimension is forbidden when either child's sum of phi, after the split and
       normalised, is below the number of parameters (G: without it, or with one
       parameter less, or with "both" for "either", the 1-D curve differs at four models
       and the 2-D one at 26). `<` or `<=` made no difference.
    8. A model with all dimensions forbidden is locked and the next worst is tried (G:
       1-D from 3 to 4 models, 2-D from 25 to 26). Locks stay; testing all models anew
       each time gave the same curves. Children start unlocked, each with its own
       lock. Growth ends when all are locked: the 1-D curve ends at 4 models.
    9. The lower half takes the parent's place, the upper half is appended. Equal errors
       take the lowest model index and the lowest dimension. The 2-D curve has one tie:
       at 9 models, models 1 and 4 (counted from 0) are mirror images in u2 and differ
       by rounding only. Both choices give the same figures (tried up to 30), since the
       networks mirror each other, but not the same boxes: compare NRMSE, not splits.
    10. NRMSE = sqrt(SSE / sum (y - mean y)^2) on the training data.
    """
    span = np.ptp(z, axis=0)
    z = (z - z.min(axis=0)) / np.where(span > 0, span, 1.0)
    x = np.column_stack([np.ones(len(z)), z]) if regressors is None else regressors
    time, dims = z.shape
    variation = np.sum((y - y.mean()) ** 2)

    lower, upper = np.zeros((1, dims)), np.ones((1, dims))
    theta = weighted_least_squares(x, y, np.ones(time))[None]
    locked: set[int] = set()
    nrmse: list[float] = []
    splits: list[tuple[int, int]] = []
    worst_gap: list[float] = []
    dim_gap: list[float] = []

    while True:
        phi = box_validity(z, lower, upper, k_sigma)
        error = y - np.sum(phi * (x @ theta.T), axis=1)
        nrmse.append(float(np.sqrt(np.sum(error**2) / variation)))
        if len(lower) >= max_models:
            break
        local = np.sum(phi * error[:, None] ** 2, axis=0)
        order = [m for m in np.argsort(-local, kind="stable") if m not in locked]
        found = None
        while order and found is None:
            worst = int(order.pop(0))
            tried = _halve(x, y, z, lower, upper, theta, worst, k_sigma)
            if not tried:
                locked.add(worst)
                continue
            found = min(tried, key=lambda dim: tried[dim][0])
            best = tried[found][0]
            rest = [tried[dim][0] for dim in tried if dim != found]
            dim_gap.append(float((min(rest) - best) / best) if rest else np.inf)
            runner = local[order[0]] if order else -np.inf
            worst_gap.append(float((local[worst] - runner) / local[worst]))
            splits.append((worst, found))
            _, lower, upper, theta = tried[found]
        if found is None:
            break

    return Lolimot(np.array(nrmse), lower, upper, theta, splits, worst_gap, dim_gap)


def _halve(
    x: Float[np.ndarray, "time params"],
    y: Float[np.ndarray, " time"],
    z: Float[np.ndarray, "time dims"],
    lower: Float[np.ndarray, "models dims"],
    upper: Float[np.ndarray, "models dims"],
    theta: Float[np.ndarray, "models params"],
    worst: int,
    k_sigma: float,
) -> dict[int, tuple[float, np.ndarray, np.ndarray, np.ndarray]]:
    """For every allowed dimension: SSE, boxes and coefficients after the split."""
    tried = {}
    for dim in range(z.shape[1]):
        middle = (lower[worst, dim] + upper[worst, dim]) / 2
        new_lower = np.vstack([lower, lower[worst]])
        new_upper = np.vstack([upper, upper[worst]])
        new_upper[worst, dim] = middle
        new_lower[-1, dim] = middle
        phi = box_validity(z, new_lower, new_upper, k_sigma)
        children = [worst, len(lower)]
        if any(np.sum(phi[:, child]) < x.shape[1] for child in children):
            continue
        new_theta = np.vstack([theta, theta[worst]])
        for child in children:
            new_theta[child] = weighted_least_squares(x, y, phi[:, child])
        error = y - np.sum(phi * (x @ new_theta.T), axis=1)
        sse = float(np.sum(error**2))
        tried[dim] = (sse, new_lower, new_upper, new_theta)
    return tried


# ---------------------------------------------------------------------- derivatives


def central_difference(
    f: Callable[[np.ndarray], np.ndarray],
    x: Float[np.ndarray, " params"],
    eps: float = 1e-6,
) -> Float[np.ndarray, "... params"]:
    """Jacobian of f at x; column i is (f(x + h e_i) - f(x - h e_i)) / 2h.

    h = eps * max(1, |x_i|). The result has the axes of f(x), then `params`. The error
    is about h^2 |f'''| / 6 + 1e-16 |f| / h: relative 1e-9 at best with eps = 1e-6.
    """
    x = np.asarray(x, dtype=float)
    columns = []
    for i in range(x.size):
        h = eps * max(1.0, abs(float(x[i])))
        above, below = x.copy(), x.copy()
        above[i] += h
        below[i] -= h
        # The step as rounded, not as asked for.
        step = above[i] - below[i]
        columns.append((np.asarray(f(above)) - np.asarray(f(below))) / step)
    return np.stack(columns, axis=-1)


def normal_equations(
    residual: Callable[[np.ndarray], np.ndarray],
    x: Float[np.ndarray, " params"],
    eps: float = 1e-6,
) -> tuple[Float[np.ndarray, "params params"], Float[np.ndarray, " params"]]:
    """J'J and J'r of all residuals, from the dense central difference Jacobian.

    J = dr/dx with the sign `residual` has, so the Gauss-Newton step is
    -solve(J'J, J'r). Sums, not means; masked or limited samples are `residual`'s to
    zero.
    """
    r = np.asarray(residual(np.asarray(x, dtype=float))).ravel()
    jacobian = central_difference(lambda p: np.asarray(residual(p)).ravel(), x, eps)
    hessian = np.zeros((len(x), len(x)))
    gradient = np.zeros(len(x))
    for t in range(len(r)):
        hessian += np.outer(jacobian[t], jacobian[t])
        gradient += jacobian[t] * r[t]
    return hessian, gradient
