"""The contract of a partition.

`PARTITIONS.register(name, partition, example=names)`: `names()` returns scheduling
variables of `jaxnarx.contracts.life.plant`, such as `["u[t-1]", "v[t-1]"]`.
"""

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from jaxnarx.contracts import validity as of_validity
from jaxnarx.contracts.life import lives, plant, pool
from jaxnarx.models import VALIDITIES, AbstractValidity
from jaxnarx.partition import grow
from jaxnarx.settings import Given, Partitioner


def _problem(dims: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Scheduling variables, columns of a constant and one term, output, weight."""
    rng = np.random.default_rng(6)
    z = rng.uniform(size=(dims, 240))
    columns = np.stack([np.ones(240), rng.normal(size=240)])
    return z, columns, np.abs(z[0] - 0.5) * columns[1], np.ones(240)


def makes_a_validity_function(partition: Partitioner, names: Sequence[str]) -> None:
    """It returns one of a class that model files know, and that holds to the contract
    of validity functions."""
    found = partition(*_problem(len(names)))
    assert isinstance(found, AbstractValidity)
    kind = type(found)
    assert VALIDITIES.get(kind.__name__) is kind, "its class is not registered"
    for check in of_validity.CHECKS_WITHOUT_NETWORK:
        check(found, len(names))


def says_the_same_twice(partition: Partitioner, names: Sequence[str]) -> None:
    """The same data give the same regions: randomness has a seed of its own."""
    first, second = (partition(*_problem(len(names))) for _ in range(2))
    pairs = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    for one, two in pairs:
        np.testing.assert_array_equal(one, two)


def does_not_look_at_samples_without_weight(
    partition: Partitioner, names: Sequence[str]
) -> None:
    """Values of samples whose weight is zero change nothing."""
    z, columns, output, weight = _problem(len(names))
    weight[::3] = 0.0
    first = partition(z, columns, output, weight)
    z, columns, output = z.copy(), columns.copy(), output.copy()
    rng = np.random.default_rng(8)
    z[:, ::3] = rng.uniform(size=z[:, ::3].shape)
    columns[:, ::3] = 1e3 * rng.normal(size=columns[:, ::3].shape)
    output[::3] = 1e3 * rng.normal(size=output[::3].shape)
    second = partition(z, columns, output, weight)
    pairs = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    for one, two in pairs:
        np.testing.assert_array_equal(one, two)


def lives_with_it(partition: Partitioner, names: Sequence[str], folder: Path) -> None:
    """A network of its regions is refined, saved, loaded and exported, or says that it
    cannot be."""
    given = Given(partition, scheduling=list(names))
    lives(grow(pool(), plant(), given).value, folder)


CHECKS = (
    makes_a_validity_function,
    says_the_same_twice,
    does_not_look_at_samples_without_weight,
    lives_with_it,
)
