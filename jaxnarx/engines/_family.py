"""Many relatives of one engine, run at once."""

from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from jaxnarx.checks import whole
from jaxnarx.engines.engine import AbstractEngine

Engine = TypeVar("Engine", bound=AbstractEngine)


def family(
    engine: Engine, key: PRNGKeyArray, count: int, *, spread: ScalarLike = 0.05
) -> Engine:
    """`count` random relatives of `engine` as one stacked tree; see `perturb`."""
    whole(count, "count")
    keys = jax.random.split(key, count)
    return jax.vmap(lambda k: engine.perturb(k, spread))(keys)


def family_run(
    engines: AbstractEngine,
    inputs: Float[Array, "time inputs"],
    *,
    chunk: int = 32,
    workers: int = 2,
) -> Float[np.ndarray, "engines time outputs"]:
    """Noise-free outputs of every engine of a stacked tree under the same `inputs`.

    As `run` under `jax.vmap`, but `chunk` engines to a compiled loop, and `workers`
    loops at a time, one to a core: such a loop keeps one core busy, and its steps cost
    little more for many engines than for a few. Not differentiable. Unlike `simulate`
    it returns NaN for an engine that breaks, and nothing else suffers.
    """
    whole(chunk, "chunk")
    whole(workers, "workers")
    count = jax.tree.leaves(engines)[0].shape[0]
    starts = range(0, count, chunk)

    def run(first: int) -> Float[np.ndarray, "engines time outputs"]:
        # The last chunk is filled up, so that one program serves all.
        members = np.minimum(np.arange(first, first + min(chunk, count)), count - 1)
        part = jax.tree.map(lambda leaf: leaf[members], engines)
        return np.asarray(_run_chunk(part, inputs))[: count - first]

    with ThreadPoolExecutor(workers) as pool:
        return np.concatenate(list(pool.map(run, starts)))


@eqx.filter_jit
def _run_chunk(
    engines: AbstractEngine, inputs: Float[Array, "time inputs"]
) -> Float[Array, "engines time outputs"]:
    return jax.vmap(lambda engine: engine.run(inputs))(engines)
