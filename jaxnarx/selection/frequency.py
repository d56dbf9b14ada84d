"""How often each term is chosen when the records are drawn anew: the bootstrap."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.checks import random_key
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.guard import guarded
from jaxnarx.methods import Backward, ForwardOLS, StepwiseF
from jaxnarx.regressors import Pool
from jaxnarx.selection.many import select_weighted


@dataclasses.dataclass(frozen=True, eq=False)
class SelectionFrequency:
    """Share of the replicates in which each term of the pool was chosen."""

    pool: Pool
    share: Float[np.ndarray, "outputs terms"]
    replicates: int

    def table(self, output: int = 0) -> dict[str, float]:
        """Terms that were chosen at all, the most frequent first."""
        order = np.argsort(-self.share[output], kind="stable")
        return {
            self.pool.name(int(t)): float(self.share[output, t])
            for t in order
            if self.share[output, t] > 0
        }


@guarded
def selection_frequency(
    pool: Pool,
    data: Dataset,
    method: ForwardOLS | StepwiseF | Backward,
    *,
    key: Array,
    replicates: int = 100,
    block: int | None = None,
) -> SelectionFrequency:
    """Bootstrap the choice: draw the records with replacement and choose again.

    Samples of one record depend on each other, so whole records are drawn; with
    `block`, records are cut into blocks of that many samples, which are drawn instead
    (for one or few records; choose it longer than the memory of the process). A term
    that is chosen in few replicates owes its place to chance. Efron and Tibshirani, "An
    Introduction to the Bootstrap" (1993), chapter 8.
    """
    if replicates < 1:
        raise SpecError(
            f"replicates must be at least 1, got {replicates}", field="replicates"
        )
    random_key(key)
    unit = _units(data, block)
    count = int(max(u.max() for u in unit)) + 1
    if count < 2:
        raise SpecError(
            "the bootstrap draws records, and there is one only; give `block`, a "
            "number of samples longer than the memory of the process",
            field="block",
        )
    drawn = np.asarray(jax.random.randint(key, (replicates, count), 0, count))
    weightings = []
    for row in drawn:
        times = np.bincount(row, minlength=count).astype(float)
        weightings.append([times[u] for u in unit])
    solutions = select_weighted(pool, data, method, weightings)
    share = np.zeros((len(pool.outputs), len(pool)))
    for solution in solutions:
        for o in range(len(pool.outputs)):
            share[o, solution.value.terms(o)] += 1.0 / replicates
    return SelectionFrequency(pool, share, replicates)


def _units(data: Dataset, block: int | None) -> list[Int[np.ndarray, " _"]]:
    """The unit of resampling every sample belongs to, record by record."""
    if block is None:
        return [np.full(len(r), n) for n, r in enumerate(data)]
    if block < 1:
        raise SpecError(f"block must be at least 1 sample, got {block}", field="block")
    units, first = [], 0
    for record in data:
        units.append(first + np.arange(len(record)) // block)
        first = int(units[-1][-1]) + 1
    return units
