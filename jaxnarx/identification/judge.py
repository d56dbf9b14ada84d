"""Free-run errors on groups left out, of methods that are trained step by step."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset, Groups, shortened
from jaxnarx.errors import DataError
from jaxnarx.identification.by_method import by_method
from jaxnarx.methods import Identification
from jaxnarx.models import Network, hold_to_range, ranged
from jaxnarx.simulation import predict, simulate

HOPELESS = 2.0, 1.5
"""Error on the first group, and on the first two or more, as a multiple of the best
candidate's there, beyond which the other groups are not tried."""


@dataclasses.dataclass(frozen=True, eq=False)
class JudgedMethod:
    """Errors of one candidate on groups left out, in standard deviations."""

    losses: Float[np.ndarray, " groups"]
    """Mean squared error of every group; NaN where it was not tried, or too short."""
    counts: Float[np.ndarray, " groups"]
    """Samples that count."""
    one_step: float
    diverged: int
    """Records."""
    network: Network | None
    """Trained on all records; None where the candidate was given up."""
    detail: str = ""

    @property
    def complete(self) -> bool:
        """Whether every group has been tried."""
        return self.network is not None


def judge(
    method: Identification,
    data: Dataset,
    groups: Groups,
    spread: float,
    best: Float[np.ndarray, " groups"] | None = None,
    rows: int | None = None,
) -> JudgedMethod:
    """Train without every group in turn, run freely over it; then train on everything.

    Given up where a run diverges, or where errors are far beyond those of the `best`
    candidate. `spread` is the output's standard deviation. Stretches of up to `rows`
    samples train; runs go over all samples of a group.
    """
    losses, counts = np.full(len(groups), np.nan), np.zeros(len(groups))
    ahead, diverged = 0.0, 0
    for g, fold in enumerate(groups.folds(data, whole=True)):
        network = trained(method, fold.train, rows)
        try:
            losses[g], counts[g], bad = score(network, fold.left, spread)
            ahead += counts[g] * score(network, fold.left, spread, k=1)[0]
        except DataError:  # too short to start from: it judges nothing
            continue
        diverged += bad
        if diverged:
            return JudgedMethod(losses, counts, np.nan, diverged, None, "diverges")
        done = slice(g + 1)
        worst = HOPELESS[min(g, 1)] ** 2
        mine = np.nansum(losses[done])
        if best is not None and mine > worst * np.nansum(best[done]):
            told = f"given up after {g + 1} of {len(groups)} groups"
            return JudgedMethod(losses, counts, np.nan, diverged, None, told)
    network = trained(method, data, rows)
    one_step = float(np.sqrt(ahead / max(counts.sum(), 1.0)))
    return JudgedMethod(losses, counts, one_step, diverged, network)


def trained(method: Identification, data: Dataset, rows: int | None = None) -> Network:
    """The network of a method, trained on at most so many samples and held to the range
    of all."""
    some = data if rows is None else shortened(data, rows)
    network = by_method(some, method, None, None).value
    return hold_to_range(network if some is data else ranged(network, data))


def score(
    network: Network, data: Dataset, spread: float, k: int | None = None
) -> tuple[float, int, int]:
    """Mean squared error, samples that count, and records that diverge; of a free run,
    or so many steps ahead. Of one output."""
    run = (simulate(network, data) if k is None else predict(network, data, k)).value
    (o,) = network.modelled
    parts = zip(data, run.outputs, run.scored, strict=True)
    errors = [(r.y[:, o] - y[:, 0])[s[:, 0]] for r, y, s in parts]
    every = np.concatenate(errors) / spread
    return float(np.mean(every**2)), len(every), int(sum(d[0] for d in run.diverged))
