"""Pruning of a grown tree: sibling leaves become one again where that costs little.

Growth is greedy. A gate that was needed when its leaf was large may serve nothing after
later ones were set. Two leaves at the same last gate are siblings; merged, the validity
of the new leaf is the sum of theirs, its model is fitted anew by weighted least squares
and all other leaves stay as they are, so every candidate costs one small fit.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.arrays import information
from jaxnarx.partition.local_fit import effective
from jaxnarx.partition.split import SplitRows
from jaxnarx.partition.tree import TreeStage, validity_of_stage


def prune(stage: TreeStage, rows: SplitRows, *, oblique: bool = True) -> TreeStage:
    """Merge siblings, the best pair first, while the corrected Akaike criterion falls.

    `stage` is one stage of `sigmoid_tree` on `rows`, and `oblique` as there. Returns a
    stage at its own size (models = count), which is the given one without its empty
    slots where no merger pays. A ridge pulls a merged model to the mean of its parts.
    Runs on the host; one compiled fit serves all candidates.
    """
    tree = _begin(stage, rows, oblique)
    while True:
        merged = [_merge(tree, rows, *pair) for pair in _siblings(tree.path)]
        if not merged:
            break
        best = min(merged, key=lambda t: t.criterion)
        if not best.criterion < tree.criterion:
            break
        tree = best
    kept = {f.name: getattr(tree, f.name) for f in dataclasses.fields(TreeStage)}
    return TreeStage(**{name: jnp.asarray(value) for name, value in kept.items()})


@dataclasses.dataclass(frozen=True)
class _Tree:
    """A stage on the host, with what makes mergers cheap.

    `gate` is the number of parameters that a gate counts, `samples` that of the rows.
    """

    direction: Float[np.ndarray, "gates dims"]
    border: Float[np.ndarray, " gates"]
    log_steepness: Float[np.ndarray, " gates"]
    path: Int[np.ndarray, "models gates"]
    theta: Float[np.ndarray, "models terms"]
    sse: float
    phi: Float[np.ndarray, "models rows"]
    traces: Float[np.ndarray, " models"]
    output: Float[np.ndarray, " rows"]
    gate: int
    samples: float

    @property
    def count(self) -> int:
        """Number of leaves."""
        return len(self.theta)

    @property
    def effective(self) -> float:
        """Effective number of parameters."""
        return float(self.traces.sum()) + self.gate * len(self.border)

    @property
    def criterion(self) -> float:
        """AICc."""
        sse, size = np.array([self.sse]), np.array([self.effective])
        return float(information(sse, size, self.samples)["aicc"][0])


def _begin(stage: TreeStage, rows: SplitRows, oblique: bool) -> _Tree:
    """The stage without empty slots."""
    n = int(stage.count)
    shape = validity_of_stage(jax.tree.map(lambda a: a[None], stage), 0, n)
    theta = stage.theta[:n]
    phi = shape(rows.z, jnp.ones(n, bool))
    traces = jax.lax.map(lambda m: _trace(rows, *m), (phi, theta))
    output = jnp.sum(phi * (theta @ rows.p), axis=0)
    host = {"theta": theta, "phi": phi, "traces": traces, "output": output}
    for name in ("direction", "border", "log_steepness", "path"):
        host[name] = getattr(shape, name)
    return _Tree(
        **{name: np.asarray(value) for name, value in host.items()},
        sse=float(stage.sse),
        gate=shape.direction.shape[1] if oblique else 0,
        samples=float(jnp.sum(rows.weight > 0)),
    )


def _siblings(path: Int[np.ndarray, "models gates"]) -> list[tuple[int, int, int]]:
    """Gates with two leaves and no gate behind them: (gate, first leaf, second)."""
    behind = [np.flatnonzero(path[:, g]) for g in range(path.shape[1])]
    return [(g, int(m[0]), int(m[1])) for g, m in enumerate(behind) if len(m) == 2]


def _merge(tree: _Tree, rows: SplitRows, gate: int, first: int, second: int) -> _Tree:
    """Put one leaf in place of two; the gate is gone."""
    pair = [first, second]
    parts, both = jnp.asarray(tree.phi[pair]), jnp.asarray(tree.theta[pair])
    merged = _refit(rows, parts, both, jnp.asarray(tree.output))
    theta, trace, output, sse = (np.asarray(a) for a in merged)
    new = {"theta": theta, "traces": trace, "phi": tree.phi[pair].sum(axis=0)}
    for name, value in new.items():
        array = getattr(tree, name).copy()
        array[first] = value
        new[name] = np.delete(array, second, axis=0)
    for name in ("direction", "border", "log_steepness"):
        new[name] = np.delete(getattr(tree, name), gate, axis=0)
    path = np.delete(np.delete(tree.path, second, axis=0), gate, axis=1)
    figures = {"path": path, "output": output, "sse": float(sse)}
    return dataclasses.replace(tree, **new, **figures)


@jax.jit
def _refit(
    rows: SplitRows,
    parts: Float[Array, "2 rows"],
    theta: Float[Array, "2 terms"],
    output: Float[Array, " rows"],
):
    """A merged leaf's coefficients and trace, the network's output and its SSE."""
    phi = parts[0] + parts[1]
    mass = parts @ rows.weight
    share = mass / jnp.maximum(jnp.sum(mass), jnp.finfo(mass.dtype).tiny)
    fitted = rows.fit(phi, share @ theta)
    own = jnp.sum(parts * (theta @ rows.p), axis=0)
    output = output - own + phi * (fitted @ rows.p)
    miss = jnp.where(rows.weight > 0, rows.y - output, 0.0)
    return fitted, _trace(rows, phi, fitted), output, jnp.sum(rows.weight * miss**2)


def _trace(
    rows: SplitRows, phi: Float[Array, " rows"], theta: Float[Array, " terms"]
) -> Float[Array, ""]:
    """Effective parameters of one leaf."""
    used = rows.used_terms(theta)[None]
    return effective(rows.p, phi[None], rows.weight, used, rows.ridge)
