"""The verb `uncertainty`: how well data determine the parameters of a network.

About the least-squares estimate with residuals r = run - measured and J = dr/dp,

    cov p = B^-1 M B^-1,   B = sum w J'J,   M = sum w J' R J w + start,

R the covariance of the noise. With one output and white noise this is s^2 (J'J)^-1,
s^2 = r'r / (n - p). `refine` weighs every output by its variance, not by that of its
noise, so with several coupled outputs the sandwich stays. The run starts from measured,
hence noisy, outputs: its transient moves the estimate too, and that is `start`,
sum_records (w J'H) cov(start) (w J'H)' with H the derivative by the starting samples.

Reference: T. Soderstrom and P. Stoica, System Identification, Prentice Hall 1989,
section 7.5; L. Ljung, System Identification, 2nd ed. 1999, sections 9.3 and 9.4.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import not_negative
from jaxnarx.confidence.information import Sums, sums
from jaxnarx.confidence.noise import OutputNoise, estimate_noise
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.formatting import align_columns, page
from jaxnarx.models import Network, depth
from jaxnarx.refinement import (
    Labels,
    Layout,
    TrainingData,
    label,
    make_layout,
    make_task,
)
from jaxnarx.simulation import Prepared, check_records, has_diverged, run
from jaxnarx.solution import RESULTS, Solution

NULL_ROUNDINGS = 4096
"""Eigenvalues of the scaled J'J below so many roundings of the largest are zero: in
float64 a condition of the Jacobian of a million. Normal equations cannot tell more."""
NAMED_SHARE = 0.01
"""Share of a parameter's unit vector in the undetermined directions from which it is
named."""


@dataclasses.dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance of trained parameters, in the units that `Network.equations` shows.

    `names` and `estimate` list them without padding: coefficients for signals in
    physical units, centres and widths in the unit of their scheduling variable.
    `identifiable` is False where the data leave a parameter, or a combination in which
    it takes part, undetermined: `covariance` then is that of the determined part alone.
    `noise` is the standard deviation of each output's noise in its unit, `freedom` the
    samples it rests on less the parameters. The remaining fields serve `bands`.
    """

    names: tuple[str, ...]
    estimate: Float[np.ndarray, " params"]
    covariance: Float[np.ndarray, "params params"]
    identifiable: Bool[np.ndarray, " params"]
    noise: Float[np.ndarray, " outputs"]
    freedom: Float[np.ndarray, " outputs"]
    output_names: tuple[str, ...]
    layout: Layout
    labels: Labels
    start: Float[np.ndarray, "starts starts"]

    def __str__(self) -> str:
        return self.table

    _repr_html_ = page

    @property
    def standard_error(self) -> Float[np.ndarray, " params"]:
        """Standard deviation of every estimate."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def correlation(self) -> Float[np.ndarray, "params params"]:
        """Correlation of the estimates; zero beside one with no variance."""
        error = self.standard_error
        safe = np.where(error > 0, error, 1.0)
        return self.covariance / np.outer(safe, safe)

    @property
    def table(self) -> str:
        """Estimates with standard errors, as text; a dash where undetermined."""
        rows = [("parameter", "estimate", "std. error", "ratio")]
        columns = (self.names, self.estimate, self.standard_error, self.identifiable)
        for name, value, error, known in zip(*columns, strict=True):
            ratio = f"{abs(value) / error:.1f}" if known and error > 0 else "-"
            shown = f"{error:.3g}" if known else "-"
            rows.append((name, f"{value:.6g}", shown, ratio))
        lines = align_columns(rows)
        pairs = zip(self.output_names, self.noise, self.freedom, strict=True)
        lines += [
            f"noise of {name}: {s:.4g} ({n:.0f} degrees of freedom)"
            for name, s, n in pairs
        ]
        return "\n".join(lines)


@guard_arguments
def uncertainty(
    network: Network,
    data: Dataset | Prepared,
    *,
    trainable: Network | None = None,
    noise: str = "white",
    start: str = "measured",
    ridge: float | int = 0.0,
) -> Solution[Uncertainty]:
    """Covariance of the parameters that `refine` fitted to the free run of `data`.

    To first order about `network`, which should be the minimum on just these records.
    The estimate is taken to be that of least squares: after a robust loss, a transform,
    or weights of records the covariance is that of another estimator.

    Residuals of engine models are correlated in time: with `noise="coloured"` an
    autoregression of each output's residuals, its order chosen by AIC up to 10 log10 n,
    takes the place of white noise. Outputs are independent of one another either way.
    Strong correlation leaves few independent samples, part of which the parameters
    absorb: 24 parameters on 800 samples of noise with pole 0.9 give bands of 95 % that
    cover 91 %; as white noise they would cover 48 %.

    Validity functions are often over-parametrised: two Gaussians in one variable have
    four parameters, but their ratio only three. Status `unidentifiable` names such
    groups (`stats["group"]`); everything stays finite, see `Uncertainty`, and bands
    rest on what is determined. `diverged`: the run leaves its bounds, so the residuals
    say nothing; `too_short`: no more samples than parameters.

    Args:
        network: The refined model.
        data: The records it was refined on.
        trainable: As in `refine`: what was frozen there is known exactly here.
        noise: "white" or "coloured".
        start: Whether the measured samples a run starts from carry that noise
            ("measured") or none ("exact").
        ridge: As in `SimulationError`: it shrinks the covariance, and the bias it
            causes is not part of it.

    Returns:
        `value` holds `names`, `estimate`, `covariance` and what `bands` needs; `stats`
        has `rank`, `cond` (of the scaled Jacobian) and the chosen `order` of each
        output's noise.
    """
    _require_one_of(noise, ("white", "coloured"), "noise")
    _require_one_of(start, ("measured", "exact"), "start")
    ridge = not_negative(ridge, "ridge")
    network.require_measured("The uncertainty of parameters")
    network.require_no_roots("The uncertainty of parameters")
    task, _ = make_task(network, check_records(network, data))
    layout = make_layout(network, trainable, (0.5, 2.0))
    labels = label(network, layout)

    y = np.asarray(run(network, task.drive, task.anchors(None)))
    residual, scored = y - np.asarray(task.drive.measured), task.masks.scored
    found = estimate_noise(
        residual, scored, coloured=noise == "coloured", depth=depth(network)
    )
    total = _sums(network, layout, task, found)
    bread = np.asarray(total.bread, float)[np.ix_(labels.real, labels.real)]
    rounding = float(np.finfo(y.dtype).eps)
    inverse, lost, condition = pseudo_inverse(bread, float(ridge), rounding)
    owner = labels.output[labels.real]
    outputs = range(len(network.models))
    used = np.array([np.sum((1 - lost)[owner == o]) for o in outputs])
    found = found.less(used)
    begin = start_covariance(found) * (start == "measured")
    # Where sensitivities overflow nothing is determined, and the status says so.
    with np.errstate(over="ignore", invalid="ignore"):
        meat = _meat(total, found, begin)[np.ix_(labels.real, labels.real)]
        spread = inverse @ meat @ inverse
    spread = spread if np.all(np.isfinite(spread)) else np.zeros_like(spread)
    value = _value(network, layout, labels, found, begin, spread, lost)
    pairs = zip(value.names, value.identifiable, strict=True)
    stats = {
        "rank": int(round(np.sum(1 - lost))),
        "cond": condition,
        "order": [int(np.count_nonzero(a)) for a in found.shape],
        "freedom": found.freedom,
        "group": [name for name, known in pairs if not known],
    }
    status, detail = _status(network, task, y, total, found, used, stats)
    return Solution(value, status, stats, detail)


def _require_one_of(value: str, known: tuple[str, ...], field: str) -> None:
    if value not in known:
        names = " or ".join(map(repr, known))
        raise SpecError(f"{field} must be {names}, got {value!r}", field=field)


def _sums(
    network: Network, layout: Layout, task: TrainingData, noise: OutputNoise
) -> Sums:
    """`sums` of one run over the whole records."""
    dtype = np.asarray(task.weight).dtype
    return sums(
        network,
        layout,
        task.drive,
        task.anchors(None),
        jnp.asarray(task.masks.start),
        task.weight,
        jnp.asarray(noise.shape.astype(dtype)),
    )


def pseudo_inverse(
    gram: Float[np.ndarray, "params params"], ridge: float, rounding: float
) -> tuple[Float[np.ndarray, "params params"], Float[np.ndarray, " params"], float]:
    """Inverse of J'J + ridge diag(J'J) on the determined directions, zero elsewhere.

    Columns of J are brought to unit length first, so that units do not matter. It comes
    with the share of each parameter in the undetermined directions, 0 to 1, and the
    condition of the scaled J over the determined ones. A parameter whose numbers are
    not finite counts as undetermined altogether.
    """
    params = gram.shape[0]
    if not np.all(np.isfinite(gram)):
        return np.zeros_like(gram), np.ones(params), np.inf
    size = np.sqrt(np.diagonal(gram))
    safe = np.where(size > 0, size, 1.0)
    value, vector = np.linalg.eigh(gram / np.outer(safe, safe))
    # A ridge moves the eigenvalues alone; it determines nothing by itself.
    kept = value > NULL_ROUNDINGS * rounding * value.max(initial=0.0)
    root = np.where(kept, 1.0 / np.sqrt(np.where(kept, value + ridge, 1.0)), 0.0)
    half = vector * root[None] / safe[:, None]
    lost = np.sum(np.where(kept[None], 0.0, vector) ** 2, axis=1)
    known = value[kept]
    condition = float(np.sqrt(known[-1] / known[0])) if kept.any() else np.inf
    return half @ half.T, np.where(size > 0, lost, 1.0), condition


def start_covariance(noise: OutputNoise) -> Float[np.ndarray, "starts starts"]:
    """Covariance of the measured samples a run starts from, output by output."""
    blocks = [scipy.linalg.toeplitz(c) for c in noise.covariance]
    return np.asarray(scipy.linalg.block_diag(*blocks))


def _meat(total: Sums, noise: OutputNoise, begin: np.ndarray) -> np.ndarray:
    """M: noise during the run, the rest of its filter, and noise of the start."""
    _, during, states, by_start = (np.asarray(part, float) for part in total)
    meat = np.einsum("rph,hi,rqi->pq", by_start, begin, by_start)
    for o, variance in enumerate(noise.innovation.tolist()):
        left, state = rest_of_filter(noise.shape[o]), states[:, o]
        tail = np.einsum("rkp,kl,rlq->pq", state, left, state)
        meat = meat + variance * (during[o] + tail)
    return meat


def rest_of_filter(
    shape: Float[np.ndarray, " order"],
) -> Float[np.ndarray, "order order"]:
    """Q with s'Qs the sum of squares a filter gives without input from the state s.

    The state is its last outputs, newest first; the filter must be stable.
    """
    order = len(shape)
    if not order:
        return np.zeros((0, 0))
    companion = np.eye(order, k=-1)
    companion[0] = shape
    once = np.outer(shape, shape)
    return np.asarray(scipy.linalg.solve_discrete_lyapunov(companion.T, once))


def _value(network, layout, labels: Labels, noise: OutputNoise, begin, spread, lost):
    real = labels.real
    slope = labels.slope[real]
    gain = np.asarray(network.gain)[list(network.signals)]
    return Uncertainty(
        names=tuple(n for n, keep in zip(labels.names, real, strict=True) if keep),
        estimate=labels.value[real],
        covariance=spread * np.outer(slope, slope),
        identifiable=lost < NAMED_SHARE,
        noise=np.sqrt(noise.covariance[:, 0]) * gain,
        freedom=noise.freedom,
        output_names=tuple(network.output_names),
        layout=layout,
        labels=labels,
        start=begin,
    )


def _status(network, task, y, total, noise, used, stats: dict[str, Any]):
    """The status of the estimate, the gravest trouble first, and one sentence about
    it."""
    held = (y <= np.asarray(network.lower)) | (y >= np.asarray(network.upper))
    names, scored = network.output_names, task.masks.scored
    for o, name in enumerate(names):
        records = range(len(held))
        bad = [n for n in records if has_diverged(held[n, scored[n, :, o], o])]
        if bad or not np.all(np.isfinite(np.asarray(total.bread))):
            stats |= {"channel": name, "record": bad[0] if bad else None}
            where = f"of {name} " if bad else ""
            text = f"the free run {where}is unstable; its residuals are not noise"
            return RESULTS.diverged, text
    for o in np.flatnonzero(noise.samples <= used + 0.5).tolist():
        stats["channel"] = names[o]
        text = (
            f"{names[o]} has {noise.samples[o]} samples for {used[o]:.0f} parameters; "
            "their noise cannot be estimated"
        )
        return RESULTS.too_short, text
    if stats["group"]:
        group = stats["group"]
        shown = ", ".join(group[:6]) + (", ..." if len(group) > 6 else "")
        text = f"the data do not determine {len(group)} parameters: {shown}"
        return RESULTS.unidentifiable, text
    return RESULTS.ok, ""
