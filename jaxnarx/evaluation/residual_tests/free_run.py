"""Residuals of the free run: do the inputs tell something that the model misses?"""

import dataclasses
from typing import Any

import numpy as np
import scipy.fft
import scipy.special
from jaxtyping import Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Channel, Dataset, scaling_unit
from jaxnarx.deprecation import old_method
from jaxnarx.errors import SpecError
from jaxnarx.evaluation.residual_tests.bounds import joint_p, joint_score
from jaxnarx.evaluation.residual_tests.correlations import remove_mean
from jaxnarx.evaluation.residual_tests.lag_tests import LagTest
from jaxnarx.evaluation.residual_tests.lagged import lagged_products
from jaxnarx.evaluation.residual_tests.one_step import usable_inputs
from jaxnarx.formatting import align_columns, page
from jaxnarx.models import Network
from jaxnarx.simulation import Prepared, simulate, stack_batch
from jaxnarx.solution import RESULTS, Solution

SPARE_SAMPLES = 10
"""Samples needed beside those for the lags."""


@dataclasses.dataclass(frozen=True, eq=False)
class FreeRunResiduals:
    """Correlations of one output's free-run residual, measured minus simulated.

    `autocorrelation` shows the colour of the residual and tests nothing: a free run
    leaves coloured residuals, its noise among them. `inputs` test whether an input
    correlates with the residual at any lag from 0 on. Mean and deviation are in the
    unit of the output.
    """

    output: Channel
    samples: int
    mean: float
    deviation: float
    autocorrelation: LagTest
    inputs: tuple[LagTest, ...]

    def significant_inputs(self, level: float = 0.05) -> list[str]:
        """Inputs that tell of the residual, at a joint `level` for all (Holm 1979)."""
        names = []
        for n, test in enumerate(sorted(self.inputs, key=lambda t: t.p)):
            if test.p > level / (len(self.inputs) - n):
                break
            names.append(test.signal)
        return names

    found = old_method("found", "significant_inputs")

    def __str__(self) -> str:
        rows = [("input", "p", "largest share", "at lag")]
        for test in self.inputs:
            cells = f"{test.p:.2g}", f"{100 * test.effect:.2g} %", str(test.worst)
            rows.append((test.signal, *cells))
        return "\n".join(
            [
                f"{self.output.label}: {self.samples} free-run residuals, mean "
                f"{self.mean:.4g}, standard deviation {self.deviation:.4g}",
                *(f"  {line}" for line in align_columns(rows)),
            ]
        )

    _repr_html_ = page


@guard_arguments
def diagnose_free_run(
    network: Network,
    data: Dataset | Prepared,
    *,
    lags: int = 20,
    level: float = 0.05,
    simulated: Any = None,
) -> Solution[tuple[FreeRunResiduals, ...]]:
    """Test whether the inputs explain what the free run misses.

    If the model is right its free-run residual is noise that knows nothing of the
    inputs, of whatever colour. The correlation with an input then has the variance
    sum over tau of R_u(tau) R_e(tau) (Bartlett 1946), here tapered by a triangle over
    half of the longest record; bounds for white residuals would find something in every
    free run.

    Args:
        network: The model; hidden channels are welcome.
        data: Records with its channels, at its sample time.
        lags: Samples over which correlations are taken.
        level: Probability that a bound is wrong.
        simulated: The free run where it is at hand.

    Returns:
        A value for every output that has enough samples and does not diverge; status
        `too_short` or `diverged` where one is left out.

    Reference: L. Ljung, System Identification, 1999, section 16.6, (16.66).

    Example:
        print(jnx.evaluation.diagnose_free_run(network, data).value[0])
    """
    if lags < 1 or not 0 < level <= 0.5:
        raise SpecError("lags is at least 1, level above 0 and up to 0.5", field="lags")
    matched, batch = stack_batch(network, data)
    run = simulate(network, data).value if simulated is None else simulated
    run = run.value if isinstance(run, Solution) else run
    found, status = [], RESULTS.ok
    for o, channel in enumerate(network.output_channels):
        lost = any(bool(d[o]) for d in run.diverged)
        error = np.zeros(batch.valid.shape[:2])
        known = np.zeros(error.shape, bool)
        for n, record in enumerate(matched):
            rows = slice(0, len(record))
            error[n, rows] = record.y[:, network.modelled[o]] - run.outputs[n][:, o]
            known[n, rows] = run.scored[n][:, o]
        if lost or known.sum() < lags + SPARE_SAMPLES:
            status = RESULTS.diverged if lost else RESULTS.too_short
            continue
        found.append(_test_inputs(network, batch, channel, error, known, lags, level))
    return Solution(tuple(found), status, {"outputs": len(found)})


def _test_inputs(
    network, batch, channel, error, known, lags, level
) -> FreeRunResiduals:
    mean, deviation = float(error[known].mean()), float(error[known].std())
    value = remove_mean(
        np.where(known, error / scaling_unit(error.ravel()), 0.0), known
    )
    at = np.arange(1, lags + 1)
    norm = float(np.sum(value**2)) or 1.0
    own = lagged_products(value, value, at) / norm
    edge = np.full(lags, scipy.special.ndtri(1 - level / 2) / np.sqrt(known.sum()))
    colour = _white_autocorrelation(own, edge, at)
    tests, count = [], int(known.sum())
    for signal, one in enumerate(network.channels.inputs):
        u, there = usable_inputs(batch, signal)
        if there.any() and np.ptp(u[there]) > 0:
            centred = remove_mean(u, there)
            tests.append(_correlation(centred, value, count, one.name, lags, level))
    return FreeRunResiduals(channel, count, mean, deviation, colour, tuple(tests))


def _correlation(
    u: Float[np.ndarray, "records time"],
    e: Float[np.ndarray, "records time"],
    samples: int,
    name: str,
    lags: int,
    level: float,
) -> LagTest:
    """Correlation of the residual with an input, k = -`lags` to `lags`; from 0 on it is
    tested."""
    at = np.arange(-lags, lags + 1)
    norm = float(np.sqrt(np.sum(u**2) * np.sum(e**2))) or 1.0
    value = lagged_products(u, e, at) / norm
    spread = product_covariance(u, e, samples, 2 * lags + 1) / norm**2
    covariance = spread[np.abs(at[:, None] - at[None])]
    deviation = np.full(len(at), np.sqrt(max(float(spread[0]), 1e-300)))
    tested = at >= 0
    correlation = covariance / (deviation[0] ** 2)
    critical = joint_score(correlation[np.ix_(tested, tested)], level)
    one = float(scipy.special.ndtri(1 - level / 2))
    largest = float(np.max(np.abs(value[tested]) / deviation[tested]))
    return LagTest(
        name="input",
        signal=name,
        lags=at,
        value=value,
        low=-one * deviation,
        high=one * deviation,
        joint_low=-critical * deviation,
        joint_high=critical * deviation,
        tested=tested,
        p=joint_p(largest, critical, level),
        covariance=covariance,
    )


def product_covariance(
    u: Float[np.ndarray, "records time"],
    e: Float[np.ndarray, "records time"],
    samples: int,
    lags: int,
) -> Float[np.ndarray, " lags"]:
    """cov(T_j, T_k) by |j - k| of T_k = sum u(t-k) e(t), for u and e independent.

    sum over tau of R_u(tau + j - k) w(tau) R_e(tau)/samples, with R the lagged products
    of all records: the triangle w makes the matrix positive, for it is a mean of the
    spectrum over neighbouring frequencies.
    """
    time = u.shape[1]
    width = max(time // 2, 2)
    size = int(scipy.fft.next_fast_len(2 * time + lags, real=True) or 1)
    steps = np.minimum(np.arange(size), size - np.arange(size))
    taper = np.maximum(1 - steps / width, 0.0)
    of_u, of_e = (
        np.sum(np.abs(np.fft.rfft(rows, size, axis=1)) ** 2, axis=0) for rows in (u, e)
    )
    smooth = np.fft.rfft(np.fft.irfft(of_e, size) * taper).real / samples
    return np.fft.irfft(of_u * np.maximum(smooth, 0.0), size)[:lags]


def _white_autocorrelation(
    value: Float[np.ndarray, " lags"],
    edge: Float[np.ndarray, " lags"],
    at: Int[np.ndarray, " lags"],
) -> LagTest:
    """The autocorrelation, with the bounds of white residuals for the eye."""
    return LagTest(
        name="autocorrelation",
        signal="",
        lags=at,
        value=value,
        low=-edge,
        high=edge,
        joint_low=-edge,
        joint_high=edge,
        tested=np.zeros(len(at), bool),
        p=1.0,
        covariance=np.diag(edge**2),
    )
