"""The verb `bands`: how sure a network's free run is, sample by sample."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.confidence._uncertainty import Uncertainty
from jaxnarx.confidence.enclosure import AbstractEnclosure
from jaxnarx.confidence.information import variances
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.models import Network, report_outputs
from jaxnarx.refinement import Layout
from jaxnarx.simulation import (
    Prepared,
    ensure_prepared,
    first_anchor,
    make_masks,
    simulate,
)
from jaxnarx.solution import Solution


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Bands(AbstractEnclosure):
    """A free run with pointwise bands, one array per record, in physical units.

    `lower` and `upper` enclose the run a perfect network would give, without noise;
    `measured_lower` and `measured_upper` a new measurement of it. `deviation` is the
    standard deviation behind the first pair. `run` is the free run they belong to.
    """

    measured_lower: tuple[Float[np.ndarray, "_ outputs"], ...]
    measured_upper: tuple[Float[np.ndarray, "_ outputs"], ...]
    deviation: tuple[Float[np.ndarray, "_ outputs"], ...]


@guard_arguments
def bands(
    network: Network,
    uncertainty: Uncertainty,
    data: Dataset | Prepared,
    *,
    level: float | int = 0.95,
) -> Solution[Bands]:
    """Free run of every record with pointwise bands of probability `level`.

    To first order the run errs by S_t dp + H_t dh with dp the error of the parameters
    and dh that of the measured samples it starts from, so its variance is
    S_t C S_t' + H_t C_h H_t'; a measurement adds the variance of its noise. Half widths
    are quantiles of Student's t. The start of `data` is taken as independent of the
    estimate, as it is on records that were not fitted.

    Statuses and the run are those of `simulate`. Where the feedback bound holds a
    sample, parameters move it no more and the band of the run has no width; it never
    leaves the bound, nor what a model with limits reports. Where sensitivities
    overflow, it is the whole range between the bounds. Before the first prediction the
    run repeats the measurement, and both bands are those of its noise. Always finite.

    Args:
        network: The model.
        uncertainty: Covariance of `network`, or of one with the same structure.
        data: Records with its channels, at its sample time.
        level: Probability of a band, between 0 and 1.

    Returns:
        `value` holds by record, in physical units, `lower` and `upper` of the run,
        `measured_lower` and `measured_upper` of a new measurement, and the `run`
        itself.

    Reference: T. Soderstrom and P. Stoica, System Identification, 1989, section 11.3;
    G. Seber and C. Wild, Nonlinear Regression, Wiley 1989, section 5.1.
    """
    if not 0 < level < 1:
        raise SpecError(f"level must lie between 0 and 1, got {level}", field="level")
    _require_same(network, uncertainty)
    runs, origin = ensure_prepared(network, data)
    simulated = simulate(network, runs)
    data, batch = origin.matched, origin.batch
    masks = make_masks(network, batch)
    layout = uncertainty.layout
    layout = Layout(
        network, layout.low, layout.high, layout.chosen, owners=layout.owners
    )
    scaled = variances(
        network,
        layout,
        runs.drive,
        jnp.asarray(first_anchor(masks)),
        jnp.asarray(masks.start),
        jnp.asarray(root(uncertainty).astype(network.gain.dtype)),
    )
    inputs = [record.u for record in data]
    value = _bands(
        *(network, uncertainty, simulated.value),
        *(inputs, scaled, masks.start, level),
    )
    return Solution(value, simulated.status, simulated.stats, simulated.detail)


def _require_same(network: Network, uncertainty: Uncertainty) -> None:
    """The covariance must belong to a network of this structure."""
    own = uncertainty.layout.base

    def shapes(tree):
        return [np.shape(leaf) for leaf in jax.tree.leaves(tree)]

    same = jax.tree.structure(network) == jax.tree.structure(own)
    if not same or shapes(network) != shapes(own):
        raise SpecError(
            "the uncertainty belongs to a network of another structure; call "
            "uncertainty(network, data) with this network",
            field="uncertainty",
        )


def square_root(
    covariance: Float[np.ndarray, "n n"],
) -> Float[np.ndarray, "n n"]:
    """F with F F' the covariance, which may be singular.

    It uses eigenvalues of the correlations; those that rounding made negative are zero.
    """
    size = np.sqrt(np.diagonal(covariance))
    safe = np.where(size > 0, size, 1.0)
    value, vector = np.linalg.eigh(covariance / np.outer(safe, safe))
    return size[:, None] * vector * np.sqrt(np.maximum(value, 0.0))[None]


def root(uncertainty: Uncertainty) -> Float[np.ndarray, "columns rank"]:
    """F for parameters (zero rows for padding) and start, in the network's units."""
    labels, start = uncertainty.labels, square_root(uncertainty.start)
    own = square_root(uncertainty.covariance) / labels.slope[labels.real][:, None]
    total, params = len(labels.names), own.shape[1]
    found = np.zeros((total + len(start), params + len(start)))
    found[np.flatnonzero(labels.real), :params] = own
    found[total:, params:] = start
    return found


def _bands(
    network, uncertainty: Uncertainty, run, inputs, scaled, start, level
) -> Bands:
    gain = np.asarray(network.gain)[list(network.signals)]
    low, high = np.asarray(network.lower) * gain, np.asarray(network.upper) * gain
    reach = scipy.special.stdtrit(uncertainty.freedom, 0.5 + level / 2)
    before = np.sqrt(np.diagonal(uncertainty.start).reshape(len(gain), -1)[:, 0]) * gain
    columns: tuple[list, ...] = ([], [], [], [], [])
    parts = zip(run.outputs, run.computed, inputs, strict=True)
    for n, (y, free, u) in enumerate(parts):
        deviation = np.sqrt(np.asarray(scaled[n, : len(y)], float)) * gain
        first = min(int(start[n]), len(y))
        deviation[:first] = before
        known = np.isfinite(deviation)
        deviation = np.where(known, deviation, high - low)
        half = np.where(known, deviation * reach, np.inf)
        noisy = np.sqrt(deviation**2 + uncertainty.noise**2) * reach
        noisy[:first] = uncertainty.noise * reach
        inner = np.maximum(free - half, np.minimum(low, free))
        outer = np.minimum(free + half, np.maximum(high, free))
        for end in (inner, outer):
            end[first:] = report_outputs(network, end, u)[0][first:]
        parts = (inner, outer, y - noisy, y + noisy, deviation)
        for column, part in zip(columns, parts, strict=True):
            column.append(part)
    lower, upper, *measured, deviation = map(tuple, columns)
    return Bands(run, lower, upper, float(level), measured[0], measured[1], deviation)
