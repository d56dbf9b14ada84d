"""Sigmoid trees: the worst leaf is divided by a gate, again and again.

Each stage takes the leaf with the largest sum of validity times squared error and tries
a gate through the centre of gravity of its data across every axis. With `oblique` the
direction of the gate that made the leaf is tried too, and the best one is then turned
and moved until the squared error of the whole network is smallest, with both children
fitted inside (`split.py`). A split is forbidden when either child's validities sum to
less than `least`; a leaf without an allowed split is locked and the next worst is
tried. As validities are products along the path, a split leaves all other leaves
untouched.

O. Nelles, "Axes-oblique partitioning strategies for local model networks", IEEE ISIC
2006 (HILOMOT); thesis section 7.2.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.models import SigmoidTree
from jaxnarx.partition.local_fit import effective
from jaxnarx.partition.split import (
    Children,
    Leaf,
    SplitRows,
    divide,
    make_leaf,
    search,
    steepness,
    unit,
)
from jaxnarx.partition.stages import grow_stages


class TreeStage(eqx.Module):
    """One stage of the growth as it is kept: the network so far and its figures.

    Gates as in `SigmoidTree`; gates and leaves past the count are zero.
    """

    direction: Float[Array, "gates dims"]
    border: Float[Array, " gates"]
    log_steepness: Float[Array, " gates"]
    path: Int[Array, "models gates"]
    theta: Float[Array, "models terms"]
    count: Int[Array, ""]
    sse: Float[Array, ""]
    effective: Float[Array, ""]


def validity_of_stage(stages: TreeStage, stage: int, leaves: int) -> SigmoidTree:
    """Validity functions of the first `leaves` slots of a stage."""
    gates = leaves - 1
    return SigmoidTree(
        stages.direction[stage, :gates],
        stages.border[stage, :gates],
        stages.log_steepness[stage, :gates],
        stages.path[stage, :leaves, :gates],
    )


class _Growth(eqx.Module):
    """State of the growth: the last stage, and what makes the next one cheap."""

    stage: TreeStage
    phi: Float[Array, "models rows"]
    output: Float[Array, " rows"]
    traces: Float[Array, " models"]
    locked: Bool[Array, " models"]
    going: Bool[Array, ""]

    @property
    def count(self) -> Int[Array, ""]:
        """Leaves so far."""
        return self.stage.count


def sigmoid_tree(
    p: Float[Array, "terms rows"],
    z: Float[Array, "dims rows"],
    y: Float[Array, " rows"],
    weight: Float[Array, " rows"],
    *,
    smoothness: Float[Array, ""],
    ridge: Float[Array, ""],
    least: Float[Array, ""],
    max_models: int,
    oblique: bool = True,
    steps: int = 15,
    picks: int | None = None,
    first: int | None = None,
    start: SigmoidTree | None = None,
) -> TreeStage:
    """Grow to `max_models` leaves; returns every stage, stacked, the start first.

    `start` is the tree to begin with, its gates in the order of growth, whose leaves
    are fitted first; default: one leaf, and stages = max_models. `p` holds the
    regressors of every local model, `z` the scheduling variables scaled to [0, 1];
    `smoothness` is that of `split.py`, and `steps` bounds the search for one gate. A
    split is allowed where both children have validities that sum to `least` or more.
    `ridge`, `picks` and `first` are those of `local_fit`. `effective` sums the traces
    of the smoothing matrices, and with `oblique` counts the `dims` free parameters of
    every gate. Once no split is allowed the remaining stages repeat the last.
    """
    rows = SplitRows(p, z, y, weight, smoothness, ridge, least, picks, first)
    given = 1 if start is None else len(start.path)
    begin = _begin(rows, max_models, start, oblique)
    return grow_stages(
        begin,
        lambda s: _attempt(s, rows, oblique, steps),
        lambda s: s.stage,
        max_models - given,
    )


def _begin(
    rows: SplitRows, max_models: int, start: SigmoidTree | None, oblique: bool
) -> _Growth:
    """One model for everything, or those of the leaves of a tree."""
    (terms, _), dims, dtype = rows.p.shape, rows.z.shape[0], rows.p.dtype
    free = dataclasses.replace(rows, ridge=jnp.zeros_like(rows.ridge))
    phi = jnp.ones_like(rows.y)[None]
    theta = free.fit(phi[0], jnp.zeros(terms, dtype))[None]
    direction, border = jnp.zeros((0, dims), dtype), jnp.zeros(0, dtype)
    log_steepness, path = border, jnp.zeros((1, 0), int)
    if start is not None:
        free, everywhere = rows, theta[0]
        phi = start(rows.z, jnp.ones(len(start.path), bool))
        theta = jax.lax.map(lambda f: rows.fit(f, everywhere), phi)
        direction, border = start.direction, start.border
        log_steepness, path = start.log_steepness, start.path
    traces = jax.lax.map(lambda pair: _trace(free, *pair), (phi, theta))
    output = jnp.sum(phi * (theta @ rows.p), axis=0)
    leaves, gates = len(path), len(border)

    def pad(array, *size: int):
        widths = [(0, n - have) for n, have in zip(size, array.shape, strict=False)]
        return jnp.pad(array, widths + [(0, 0)] * (array.ndim - len(size)))

    stage = TreeStage(
        direction=pad(direction, max_models - 1),
        border=pad(border, max_models - 1),
        log_steepness=pad(log_steepness, max_models - 1),
        path=pad(path, max_models, max_models - 1),
        theta=pad(theta, max_models),
        count=jnp.asarray(leaves),
        sse=_sse(rows, output),
        effective=jnp.sum(traces) + (dims * gates if oblique else 0),
    )
    locked = jnp.zeros(max_models, bool)
    return _Growth(
        stage,
        pad(phi, max_models),
        output,
        pad(traces, max_models),
        locked,
        jnp.asarray(True),
    )


def _trace(rows: SplitRows, phi: Float[Array, " rows"], theta: Float[Array, " terms"]):
    """Effective parameters of one local model."""
    used = rows.used_terms(theta)[None]
    return effective(rows.p, phi[None], rows.weight, used, rows.ridge)


def _sse(rows: SplitRows, output: Float[Array, " rows"]) -> Float[Array, ""]:
    return jnp.sum(jnp.where(rows.weight > 0, rows.weight * (rows.y - output) ** 2, 0))


def _attempt(s: _Growth, rows: SplitRows, oblique: bool, steps: int) -> _Growth:
    """Divide the worst leaf that is not locked, or lock it."""
    square = jnp.where(rows.weight > 0, rows.weight * (rows.y - s.output) ** 2, 0.0)
    free = (jnp.arange(s.locked.shape[0]) < s.stage.count) & ~s.locked
    worst = jnp.argmax(jnp.where(free, s.phi @ square, -jnp.inf))
    own = s.phi[worst] * (s.stage.theta[worst] @ rows.p)
    leaf = make_leaf(rows, s.phi[worst], s.stage.theta[worst], rows.y - s.output + own)
    gate = _best_axis(_starts(s, worst, oblique), leaf, rows)
    if oblique:
        gate = search(gate, leaf, rows, steps)
    children = divide(gate, leaf, rows)
    locked = dataclasses.replace(
        s, locked=s.locked.at[worst].set(True), going=jnp.any(free)
    )
    grown = _divide(s, worst, gate, leaf, children, rows, oblique)
    allowed = jnp.any(free) & jnp.isfinite(children.sse)
    return jax.tree.map(lambda a, b: jnp.where(allowed, a, b), grown, locked)


def _starts(
    s: _Growth, worst: Int[Array, ""], oblique: bool
) -> Float[Array, "starts params"]:
    """Gates through the centre of gravity: across every axis, and the parent's.

    The parent of a leaf is the last gate on its path.
    """
    dims = s.stage.direction.shape[1]
    directions = jnp.eye(dims, dtype=s.output.dtype)
    if oblique:
        gates = s.stage.path.shape[1]
        parent = gates - 1 - jnp.argmax(s.stage.path[worst, ::-1] != 0)
        directions = jnp.concatenate([directions, s.stage.direction[parent][None]])
    return jnp.pad(directions, ((0, 0), (0, 1)))


def _best_axis(
    starts: Float[Array, "starts params"], leaf: Leaf, rows: SplitRows
) -> Float[Array, " params"]:
    """The first of the starts with the smallest error."""
    sse = jax.lax.map(lambda gate: divide(gate, leaf, rows).sse, starts)
    return starts[jnp.argmin(sse)]


def _divide(
    s: _Growth,
    worst: Int[Array, ""],
    gate: Float[Array, " params"],
    leaf: Leaf,
    children: Children,
    rows: SplitRows,
    oblique: bool,
) -> _Growth:
    """The growth with the leaf's children: one in its place, one appended."""
    direction = unit(gate[:-1])
    log_steepness = jnp.log(steepness(direction, leaf, rows.smoothness))
    new = s.stage.count
    g, pair = new - 1, jnp.stack([worst, new])
    path = s.stage.path.at[new].set(s.stage.path[worst])
    path = path.at[pair, g].set(jnp.asarray([1, -1]))
    traces = s.traces.at[pair].set(
        jax.lax.map(lambda c: _trace(rows, *c), (children.phi, children.theta))
    )
    searched = direction.shape[0] * new.astype(traces.dtype) if oblique else 0.0
    share = jnp.einsum("kn,kt,tn->n", children.phi, children.theta, rows.p)
    stage = TreeStage(
        direction=s.stage.direction.at[g].set(direction),
        border=s.stage.border.at[g].set(gate[-1] + direction @ leaf.centre),
        log_steepness=s.stage.log_steepness.at[g].set(log_steepness),
        path=path,
        theta=s.stage.theta.at[pair].set(children.theta),
        count=new + 1,
        sse=children.sse,
        effective=jnp.sum(traces) + searched,
    )
    return _Growth(
        stage,
        s.phi.at[pair].set(children.phi),
        rows.y - leaf.target + share,
        traces,
        s.locked,
        s.going,
    )
