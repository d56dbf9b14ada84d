"""Samples a network is linearised at, and its companion matrices there.

With h the last `depth` outputs and A = d y / d h, a deviation of the state
s_t = (y_(t-1), y_(t-2), ...) from another run's moves by the companion matrix: A on
top, a shift below. The state lists all outputs of the newest lag, then of the next.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.sparse.csgraph import connected_components

from jaxnarx.arrays import program
from jaxnarx.errors import DataError
from jaxnarx.models import Network, depth, fed_back_variables, sources
from jaxnarx.refinement.sensitivity import linearise_run
from jaxnarx.simulation import Masks, RunInputs

CHUNK_SAMPLES = 1024
"""Samples handled at once: one compiled program and bounded memory for any number."""


class Points(eqx.Module):
    """Samples of a run as columns: lagged and scheduling variables, and the history.

    `v` and `x` are those of `RunInputs`; `history` holds the past outputs each
    sample has seen, newest first, scaled. `record` and `step` say where the samples
    come from.
    """

    v: Float[Array | np.ndarray, "vars points"]
    x: tuple[Float[Array | np.ndarray, "_ points"], ...]
    history: Float[Array | np.ndarray, "points outputs depth"]
    record: Int[np.ndarray, " points"]
    step: Int[np.ndarray, " points"]

    def __len__(self) -> int:
        return len(self.record)

    def take(self, at: Int[np.ndarray, " some"]) -> "Points":
        """These points alone."""
        return Points(
            self.v[:, at],
            tuple(x[:, at] for x in self.x),
            self.history[at],
            self.record[at],
            self.step[at],
        )


def thin(size: int, count: int | None) -> Int[np.ndarray, " some"]:
    """Up to `count` of `size` positions, evenly spaced; None: all."""
    if count is None or size <= count:
        return np.arange(size)
    return np.unique(np.linspace(0, size - 1, count).astype(int))


def choose_points(
    network: Network,
    drive: RunInputs,
    masks: Masks,
    *,
    count: int | None = None,
    outputs: Float[np.ndarray, "records time states"] | None = None,
) -> Points:
    """Samples with a complete measured window, evenly thinned to `count`.

    Their history is the measured one, or that of `outputs`, all that a run's loop has
    carried (scaled); hidden channels are those of the history.
    Without any such sample: `DataError`.
    """
    record, step = np.nonzero(masks.anchors)
    if not len(record):
        raise DataError(
            f"no sample has {network.history} valid ones before it; stability needs "
            "samples to look at"
        )
    at = thin(len(record), count)
    record, step = record[at], step[at]
    y = np.asarray(drive.measured)[..., sources(network)]
    if outputs is not None:
        y = np.asarray(outputs)
    lag = np.arange(depth(network))[None]
    history = np.swapaxes(y[record[:, None], step[:, None] - 1 - lag], 1, 2)

    def columns(a: Float[Array, "records rows time"]) -> np.ndarray:
        return np.asarray(a)[record, :, step].T

    v, x = columns(drive.v), tuple(columns(x) for x in drive.x)
    _fill_hidden(network, v, x, history)
    return Points(v, x, history, record, step)


def _fill_hidden(network: Network, v: np.ndarray, x, history: np.ndarray) -> None:
    """Put the hidden channels of the history where measurements have none."""
    count, gain = len(network.modelled), np.asarray(network.gain)
    for row, o, d in fed_back_variables(network.variables, network.signals):
        if o >= count:
            v[row + 1] = history[:, o, d]
    for model, x_o in zip(network.models, x, strict=True):
        for row, o, d in fed_back_variables(model.scheduling, network.signals):
            if o >= count:
                x_o[row] = history[:, o, d] * gain[network.signals[o]]


def map_chunks(f, points: Points, *, axis: int) -> np.ndarray:
    """`f(v, x, history)` over all points, CHUNK of them at a time, on the host."""
    size = len(points)
    out = []
    for start in range(0, size, CHUNK_SAMPLES):
        part = points.take(
            np.minimum(np.arange(start, start + CHUNK_SAMPLES), size - 1)
        )
        found = np.asarray(f(part.v, part.x, part.history), np.float64)
        out.append(
            np.take(found, np.arange(min(CHUNK_SAMPLES, size - start)), axis=axis)
        )
    return np.concatenate(out, axis=axis)


@program
def _jacobians(network: Network, v, x, history):
    own = jnp.ones((history.shape[0], history.shape[2]), bool)
    return linearise_run(without_bounds(network), v, x, history, own)[0]


def without_bounds(network: Network) -> Network:
    """The network without its feedback bound."""
    edge = jnp.full_like(network.lower, jnp.inf)
    return eqx.tree_at(lambda n: (n.lower, n.upper), network, (-edge, edge))


def jacobians(
    network: Network, points: Points
) -> Float[np.ndarray, "points outputs outputs depth"]:
    """A at every point, as if no output were limited; host, float64."""
    return map_chunks(lambda *p: _jacobians(network, *p), points, axis=0)


def companion(a, xp=np):
    """Companion matrices (points, n, n) of A (points, outputs, outputs, depth)."""
    points, outputs, _, lags = a.shape
    top = xp.swapaxes(a, 2, 3).reshape(points, outputs, lags * outputs)
    shift = xp.eye((lags - 1) * outputs, lags * outputs, dtype=a.dtype)
    below = xp.broadcast_to(shift[None], (points, *shift.shape))
    return xp.concatenate([top, below], axis=1)


def moduli(m: Float[np.ndarray, "points n n"]) -> Float[np.ndarray, " points"]:
    """Largest modulus of the eigenvalues of every matrix; infinite if not finite."""
    fine = np.isfinite(m).all(axis=(1, 2))
    out = np.full(len(m), np.inf)
    if fine.any():
        out[fine] = np.abs(np.linalg.eigvals(m[fine])).max(axis=1)
    return out


def linked_groups(
    linked: Bool[np.ndarray, "outputs outputs"],
) -> tuple[tuple[int, ...], ...]:
    """Outputs that act on one another, directly or through others, together."""
    count, label = connected_components(linked, directed=False)
    return tuple(tuple(np.flatnonzero(label == g).tolist()) for g in range(count))


def group_block(a: np.ndarray, group: tuple[int, ...]) -> np.ndarray:
    """The block of A by which a group of outputs acts on itself."""
    at = np.array(group)
    return a[:, at[:, None], at[None]]
