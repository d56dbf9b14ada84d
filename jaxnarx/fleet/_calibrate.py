"""The verb `calibrate`: an engine of a fleet from few samples."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.fleet.broken import squared_distances
from jaxnarx.fleet.climb import Climb, climb, sums_about
from jaxnarx.fleet.coefficients import names_of, outputs_of
from jaxnarx.fleet.information import Information, gather_information, parts_of
from jaxnarx.fleet.member import find_member, know_member, prepare_member
from jaxnarx.fleet.prior import FleetPrior
from jaxnarx.fleet.rivals import (
    KINDS,
    choose,
    estimate_each,
    judge_by_blocks,
)
from jaxnarx.formatting import count, list_names
from jaxnarx.models import Network
from jaxnarx.simulation import Prepared
from jaxnarx.solution import RESULTS, Solution

BLOCKS = 5
"""Blocks of the new samples, each judged by the others."""
FEWEST_SAMPLES_PER_BLOCK = 2
"""Samples of a block at least."""
WORSE = 10.0
"""Multiple of the squared error by the mean from which a calibration has failed."""
LEAST_LEARNT = 1e-6
"""Share of the population's variance that samples must remove to tell anything."""
FOREIGN_PROBABILITY = 1e-6
"""Probability of a distance as large from which an engine is none of the fleet."""
NAMED = 5
"""Coefficients that are named as unusual."""


@guard_arguments
def calibrate(prior: FleetPrior, few: Dataset) -> Solution[Network]:
    """The network of a new engine of a fleet, from few of its samples.

    Four ways compete, output by output: the population's mean as it is, an offset and a
    gain, the population's mean and covariance with the new samples at several weights,
    and least squares of the new samples alone. Each is judged by free runs on blocks of
    the new samples that it has not seen, and by how it served donors that were
    calibrated from as many samples; the more samples, the less the donors count.

    Args:
        prior: What was learnt from the fleet.
        few: Records of the engine, with the channels of the prior's network. Of every
            record the first `prior.warm_up` samples count nowhere, as filtered inputs
            remember there what nobody measured, unless no others are left.

    Returns:
        `value` is the network, with prediction intervals where the prior's has some. In
        `stats`: `way` and `weight` by output, `scores` (kind of way: expected NRMSE by
        output), `samples`, `distance` of the engine from the population (Mahalanobis)
        with what is `expected` of a member and the `probability` of one as far,
        `unusual` coefficients (name: deviations from the mean), `learnt`, the share of
        the population's variance that the samples have removed, and `coefficients`, in
        the units of the prior. Status `ok`; `too_short` where no sample counts (the
        value is the population's mean); `unidentifiable` where the samples tell nothing
        of any coefficient, their inputs being constant, say, and the outputs at their
        mean; `diverged` where the run leaves its bounds and the mean is returned.

    Raises:
        DataError, SpecError: records that are none of such an engine.

    Example:
        prior = jnx.fleet.learn({"one": data, "other": data}, network).value
        found = jnx.fleet.calibrate(prior, data)
        print(found.stats["way"], found.stats["distance"])
    """
    runs = prepare_member(prior, few)
    counted = np.asarray(runs.scored, int).sum(axis=(0, 1))
    if not counted.any():
        text = (
            f"no sample counts behind {prior.network.before} of history; the mean of "
            "the fleet is returned"
        )
        return Solution(prior.network, RESULTS.too_short, {"samples": counted}, text)
    found = _Estimate.of(prior, runs)
    value = prior.coefficients.place(jnp.asarray(found.chosen))
    stats = _stats(prior, found, counted)
    after = _sum_squares(prior, runs, found.part, found.chosen)
    if not np.all(np.isfinite(after)) or np.any(after > WORSE * found.before + 1e-9):
        text = "calibrated, the free run leaves its bounds; the mean is returned"
        return Solution(prior.network, RESULTS.diverged, stats, text)
    value = _with_intervals(prior, value, found)
    told = _describe(prior, found, stats)
    if stats["learnt"] < LEAST_LEARNT:
        text = "the samples tell nothing of any coefficient; " + told
        return Solution(value, RESULTS.unidentifiable, stats, text)
    return Solution(value, RESULTS.ok, stats, told)


@guard_arguments
def calibrate_each(
    prior: FleetPrior, engines: Mapping[str, Dataset | DataError]
) -> dict[str, Solution[Network]]:
    """`calibrate` for many new engines by name; those of like length share programs.

    An engine whose records are none of such an engine has the population's mean, the
    status `nonfinite_data`, and what is wrong as `detail`: it stops none of the others.

    Example:
        prior = jnx.fleet.learn({"one": data, "other": data}, network).value
        found = jnx.fleet.calibrate_each(prior, {"new": data})
        print(found["new"].status_name)
    """
    found = {}
    for name in engines:
        try:
            data = engines[name]
            if isinstance(data, DataError):
                raise data
            found[str(name)] = calibrate(prior, data)
        except (DataError, SpecError) as error:
            found[str(name)] = Solution(
                prior.network, RESULTS.nonfinite_data, {}, str(error)
            )
    return found


@dataclasses.dataclass(frozen=True, eq=False)
class _Estimate:
    """The ways of calibrating one engine, and the one that is chosen."""

    prior: FleetPrior
    runs: Prepared
    part: Int[np.ndarray, "records time"]
    sums: Information
    before: Float[np.ndarray, " outputs"]
    donors: Float[np.ndarray, "ways outputs"]
    score: Float[np.ndarray, "ways outputs"]
    way: Int[np.ndarray, " outputs"]
    chosen: Float[np.ndarray, " params"]

    @classmethod
    def of(cls, prior: FleetPrior, runs: Prepared) -> "_Estimate":
        """Score all ways, then follow the best."""
        zero = np.zeros(len(prior.coefficients.free))
        edges, blocks = _blocks(runs)
        part = parts_of(runs, edges)
        at = find_member(prior, runs)
        sums = sums_about(prior.coefficients, at, runs, part, BLOCKS)
        total = sums.total()
        before = np.asarray(total.square)
        if np.any(at):
            before = _sum_squares(prior, runs, part, zero)
        noise = np.asarray(prior.population.noise)
        colour = np.asarray(prior.population.colour)
        rivals = prior.rivals
        samples = np.asarray(total.samples)
        donors = prior.foretell(np.asarray(total.gram), float(samples.max()))
        if blocks > 1:
            own = judge_by_blocks(rivals, sums, zero, noise, blocks)
            own[rivals.kinds.index("as is")] = before / np.maximum(samples, 1.0)
            # Smaller errors than donors' own coefficients leave are chance.
            own = np.log(np.maximum(own, prior.left) / prior.output_spread)
        else:
            own = donors
        way, score = choose(rivals, donors, own, samples, colour)
        given = cls(prior, runs, part, total, before, donors, score, way, at)
        return dataclasses.replace(given, chosen=given._follow())

    def _follow(self) -> Float[np.ndarray, " params"]:
        """Coefficients of every output by its own way."""
        prior, rivals = self.prior, self.prior.rivals
        noise = np.asarray(prior.population.noise)
        if prior.linear:
            one = Information(*(np.asarray(a)[None] for a in self.sums))
            given = rivals.weight, rivals.mean, rivals.root
            found = estimate_each(one, np.zeros_like(self.chosen), 1.0 / noise, *given)
            found = dict(enumerate(found[0]))
        else:
            found = {w: self._climb(w, noise) for w in set(self.way.tolist())}
        owner = outputs_of(prior.coefficients)
        # Coefficients of hidden channels are those of the first output's way.
        way = self.way[np.where(owner < len(self.way), owner, 0)]
        return np.array([found[w][n] for n, w in enumerate(way.tolist())])

    def _climb(
        self, way: int, noise: Float[np.ndarray, " outputs"]
    ) -> Float[np.ndarray, " params"]:
        """The most probable coefficients by one way."""
        rivals = self.prior.rivals
        count = noise / rivals.weight[way]
        drawn = Climb(rivals.mean[way], rivals.root[way], count, known_noise=True)
        part = jax.device_put(parts_of(self.runs, ()))
        return climb(self.prior.coefficients, self.runs, part, drawn, self.chosen)


def _sum_squares(
    prior: FleetPrior,
    runs: Prepared,
    part: Int[np.ndarray, "records time"],
    v: Float[np.ndarray, " params"],
) -> Float[np.ndarray, " outputs"]:
    """Squared errors of the run by these coefficients; by the program that judges."""
    found = gather_information(
        prior.coefficients, v, runs, jax.device_put(part), BLOCKS
    )
    return np.asarray(found.square).sum(axis=0)


def _blocks(runs: Prepared) -> tuple[tuple[int, ...], int]:
    """Numbers of samples before the edges of the blocks, and how many there are."""
    samples = int(np.asarray(runs.scored).any(axis=2).sum())
    blocks = min(BLOCKS, max(1, samples // FEWEST_SAMPLES_PER_BLOCK))
    edges = [round(samples * b / blocks) for b in range(1, blocks)]
    return tuple(edges), blocks


def _stats(
    prior: FleetPrior, found: _Estimate, counted: Int[np.ndarray, " outputs"]
) -> dict[str, Any]:
    names, rivals = prior.network.output_names, prior.rivals
    kinds = np.array(rivals.kinds)
    scores = {
        kind: dict(zip(names, np.exp(s / 2).tolist(), strict=True))
        for kind in KINDS
        for s in [found.score[kinds == kind].min(axis=0)]
    }
    one = Information(*(np.asarray(a)[None] for a in found.sums))
    zero = np.zeros((1, len(prior.coefficients.free)))
    square, freedom = squared_distances(one, zero, prior.population)
    square, freedom = float(square[0]), float(freedom[0])
    own = know_member(prior, found.sums)
    spread = np.maximum(prior.spread, 1e-12)
    unusual = own.mean / spread
    order = np.argsort(-np.abs(unusual))[:NAMED]
    labels = names_of(prior.coefficients)
    before = np.trace(np.asarray(prior.population.covariance))
    return {
        "way": {n: rivals.kinds[w] for n, w in zip(names, found.way, strict=True)},
        "weight": {
            n: float(rivals.weight[w]) for n, w in zip(names, found.way, strict=True)
        },
        "scores": scores,
        "samples": dict(zip(names, counted.tolist(), strict=True)),
        "distance": float(np.sqrt(max(square, 0.0))),
        "expected": float(np.sqrt(freedom)),
        "probability": float(scipy.stats.chi2.sf(square, max(freedom, 1.0))),
        "unusual": {labels[n]: round(float(unusual[n]), 2) for n in order.tolist()},
        "learnt": float(1 - np.trace(own.covariance) / before) if before > 0 else 0.0,
        "coefficients": found.chosen,
    }


def _describe(prior: FleetPrior, found: _Estimate, stats: dict[str, Any]) -> str:
    """What was chosen, and how far the engine is from the fleet."""
    chosen = [f"{name}: {way}" for name, way in stats["way"].items()]
    far = ""
    if stats["probability"] < FOREIGN_PROBABILITY:
        far = (
            f"; the engine is {stats['distance']:.1f} deviations from the fleet, "
            f"expected about {stats['expected']:.1f}: it may be none of it, by "
            + list_names(list(stats["unusual"]))
        )
    number = int(max(stats["samples"].values()))
    return f"{count(number, 'sample')}; {', '.join(chosen)}{far}"


def _with_intervals(prior: FleetPrior, value: Network, found: _Estimate) -> Network:
    """Intervals of donors by their own coefficients, wider by what donors that were
    calibrated from as many samples erred more."""
    errors = prior.network.errors
    if errors is None:
        return value
    own = found.donors[found.way, np.arange(len(found.way))]
    wider = np.maximum(own - np.log(prior.left / prior.output_spread), 0.0) / 2
    constant = np.asarray(errors.constant) + wider
    new = dataclasses.replace(
        errors, constant=jnp.asarray(constant, errors.constant.dtype)
    )
    return dataclasses.replace(value, errors=new)
