"""A multilayer perceptron in the place of a network's local models (thesis 6.3).

    y(t) = b(c + s (w2 . tanh(W1 (x(t) - m)/d + b1) + b2))

x are the lagged variables of a pool, m and d their mean and deviation, c and s those of
the output, b the bound of the feedback. Only the map from x to y differs from a
multi-model network: lagged variables, gains, starts, feedback bounds, the rule of
divergence and the metrics are the package's, and so is the derivative of the free run.

Training is of the one-step error (NARX), then of the free run (NOE) in windows that
grow to whole records. Every stage is Adam on all samples, then BFGS, with a little
weight decay; what is kept scores best on the validation records in the mode trained.
Several perceptrons are trained side by side as one batch: a run is a long chain of
small steps, which costs about as much for forty of them as for one.

Reference: S. Chen, S. Billings, P. Grant, Int. J. Control 51(6), 1990.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxnarx import Dataset, Network, Pool
from jaxnarx.arrays.recurrence import free_run
from jaxnarx.data.batch import stack_records
from jaxnarx.metrics import nrmse
from jaxnarx.models import assemble, depth, global_model, with_history
from jaxnarx.regressors.rows import regression_rows
from jaxnarx.simulation import (
    Trajectories,
    first_anchor,
    has_diverged,
    make_drive,
    make_masks,
)

RATE, DECAY = 0.01, 1e-4
CHUNKS = 10
"""Looks at the validation records in a stage of Adam."""


class Neural(eqx.Module):
    """A perceptron of one hidden layer and one output.

    `frame` is a network of the same pool without local models of its own: it knows the
    channels, lagged variables, gains and bounds. All numbers are of scaled signals.
    """

    frame: Network
    mean: Float[Array, " vars"]
    deviation: Float[Array, " vars"]
    centre: Float[Array, ""]
    spread: Float[Array, ""]
    net: eqx.nn.MLP

    def __call__(self, v: Float[Array, " columns"]) -> Float[Array, ""]:
        """Scaled output from the scaled lagged variables behind a leading one."""
        z = (v[1:] - self.mean) / self.deviation
        return self.centre + self.spread * self.net(z)


class Task(eqx.Module):
    """Records to be run: drive, scaled output, which samples count, and the restarts.

    `one_step` runs all samples from their measured history at once.
    """

    v: Float[Array, "records columns time"]
    measured: Float[Array, "records time 1"]
    counted: Bool[Array, "records time 1"]
    anchor: Bool[Array, "records time"]
    one_step: bool = eqx.field(static=True)


@dataclasses.dataclass(frozen=True)
class Budget:
    """Steps of Adam and BFGS in a stage, and the windows of the free run [samples]."""

    adam: int = 1500
    free_adam: int = 200
    bfgs: int = 150
    horizons: Sequence[int] = (10, 50)


def untrained(pool: Pool, data: Dataset, *, width: int, key: PRNGKeyArray) -> Neural:
    """Random weights; means and deviations are those of the rows of `data`."""
    rows = regression_rows(
        data, pool.variables, pool.outputs, history=pool.variables.longest
    )
    constant = global_model(np.zeros((1, 1), np.int64), np.zeros(1))
    frame = assemble(pool, data, rows.gain, [constant])
    x, (y,) = rows.v[1:], rows.y
    net = eqx.nn.MLP(len(x), "scalar", width, 1, activation=jnp.tanh, key=key)
    deviation = jnp.std(x, axis=1)
    deviation = jnp.where(deviation > 0, deviation, 1.0)
    return Neural(frame, jnp.mean(x, axis=1), deviation, jnp.mean(y), jnp.std(y), net)


@dataclasses.dataclass(frozen=True, eq=False)
class Lesson:
    """A perceptron to be trained: on which records, what judges it, and its size."""

    pool: Pool
    data: Dataset
    validation: Dataset
    width: int
    key: PRNGKeyArray


def resized(model: Neural, width: int) -> Neural:
    """The same perceptron with more units, or without its last ones.

    New units have zero weights. Their gradients are zero too, so they stay so.
    """
    net = model.net
    key = jax.random.key(0)
    other = eqx.nn.MLP(
        net.in_size, net.out_size, width, 1, activation=net.activation, key=key
    )

    def fitted(old, new):
        kept = old[tuple(map(slice, new.shape))]
        more = [(0, n - k) for n, k in zip(new.shape, kept.shape, strict=True)]
        return jnp.pad(kept, more)

    old, (new, shape) = (
        weights(model),
        jax.tree.flatten(eqx.filter(other, eqx.is_array)),
    )
    pairs = zip(jax.tree.leaves(old), new, strict=True)
    arrays = jax.tree.unflatten(shape, [fitted(*pair) for pair in pairs])
    return dataclasses.replace(model, net=eqx.combine(arrays, other))


def side_by_side(trees: Sequence[Any]) -> Any:
    """Trees of one structure as a batch."""
    arrays = [eqx.filter(tree, eqx.is_array) for tree in trees]
    batch = jax.tree.map(lambda *a: jnp.stack(a), *arrays)
    return eqx.combine(batch, trees[0])


def member(tree: Any, n: int) -> Any:
    """One of a batch."""
    return jax.tree.map(lambda a: a[n] if eqx.is_array(a) else a, tree)


def task(frame: Network, data: Dataset, horizon: int | None) -> Task:
    """Runs restarted every `horizon` samples; 1 is one step ahead, None a free run."""
    batch = stack_records(data)
    masks, drive = make_masks(frame, batch), make_drive(frame, batch)
    anchor, counted = first_anchor(masks), masks.scored
    if horizon is not None:
        since = np.arange(anchor.shape[1])[None] - masks.start[:, None]
        anchor = anchor | (masks.anchors & (since % horizon == 0))
    if horizon == 1:
        counted = counted & masks.anchors[:, :, None]
    where = jnp.asarray(counted), jnp.asarray(anchor)
    return Task(drive.v, drive.measured, *where, one_step=horizon == 1)


def _step(model: Neural) -> Callable:
    static = eqx.filter(model, eqx.is_array, inverse=True)

    def step(params, v, history):
        whole = eqx.combine(params, static)
        v, _ = with_history(whole.frame, v, (jnp.zeros(0, v.dtype),), history)
        return whole(v)[None]

    return step


@eqx.filter_jit
def outputs(model: Neural, task: Task) -> Float[Array, "records time 1"]:
    """Scaled outputs of every record, held within the feedback bounds."""
    frame, params = model.frame, eqx.filter(model, eqx.is_array)
    bounds = frame.lower, frame.upper
    if task.one_step:
        y = jax.vmap(jax.vmap(model, in_axes=1))(task.v)
        return jnp.clip(y[:, :, None], *(b[None, None] for b in bounds))

    def one(v, measured, anchor):
        inputs = _step(model), params, v.T, measured, anchor
        return free_run(*inputs, *bounds, depth=depth(frame))

    return jax.vmap(one)(task.v, task.measured, task.anchor)


def weights(model: Neural) -> Any:
    """What is trained: the arrays of the perceptron."""
    return eqx.filter(model.net, eqx.is_array)


def with_weights(model: Neural, arrays: Any) -> Neural:
    return eqx.tree_at(lambda m: m.net, model, eqx.combine(arrays, model.net))


def loss(arrays: Any, given: tuple[Neural, Task]) -> Float[Array, ""]:
    """Mean square error over the output's variance, and the decay of the weights."""
    model, task = given
    y = outputs(with_weights(model, arrays), task)
    error = jnp.where(task.counted, (y - task.measured) / model.spread, 0.0)
    square = sum(jnp.sum(w**2) for w in jax.tree.leaves(arrays))
    return jnp.sum(error**2) / jnp.sum(task.counted) + DECAY * square


@functools.cache
def _optimiser(steps: int) -> optax.GradientTransformation:
    """One object for a number of steps, so that its program is compiled once."""
    return optax.adam(optax.cosine_decay_schedule(RATE, steps))


@eqx.filter_jit
def _begun(model: Neural, optimiser):
    return eqx.filter_vmap(lambda m: optimiser.init(weights(m)))(model)


@eqx.filter_jit
def _adam(model: Neural, task: Task, state, optimiser, steps: int):
    """`steps` updates of the weights of a batch; the models and the states of Adam."""

    def one(model, task, state):
        def update(carry, _):
            arrays, state = carry
            gradient = jax.grad(loss)(arrays, (model, task))
            change, state = optimiser.update(gradient, state)
            return (optax.apply_updates(arrays, change), state), None

        start = weights(model), state
        (arrays, state), _ = jax.lax.scan(update, start, length=steps)
        return with_weights(model, arrays), state

    return eqx.filter_vmap(one)(model, task, state)


@eqx.filter_jit
def _polished(model: Neural, task: Task, steps: int) -> Neural:
    """BFGS from where Adam has ended; running out of steps is a normal end."""

    def one(model, task):
        solver = optx.BFGS(rtol=1e-6, atol=1e-9)
        given = loss, solver, weights(model), (model, task)
        found = optx.minimise(*given, max_steps=steps, throw=False)
        return with_weights(model, found.value)

    return eqx.filter_vmap(one)(model, task)


def error(model: Neural, task: Task) -> Float[Array, ""]:
    """Pooled NRMSE of the counted samples."""
    parts = task.measured, outputs(model, task), task.counted
    return nrmse(*(a.reshape(-1, 1) for a in parts))[0]


@eqx.filter_jit
def _errors(model: Neural, task: Task) -> Float[Array, " members"]:
    return eqx.filter_vmap(error)(model, task)


def _best(looks: Sequence[Neural], task: Task) -> Neural:
    """Of every member the look with the smallest error."""
    found = np.stack([np.asarray(_errors(model, task)) for model in looks])
    at = np.where(np.isnan(found), np.inf, found).argmin(axis=0)

    def taken(*arrays):
        if not eqx.is_array(arrays[0]):
            return arrays[0]
        return jnp.stack(arrays)[at, np.arange(len(at))]

    return jax.tree.map(taken, *looks)


def _stage(model: Neural, task: Task, judge: Task, adam: int, bfgs: int) -> Neural:
    """Train on one task; the best by `judge` of every look, the start among them."""
    chunk = max(adam // CHUNKS, 1)
    optimiser = _optimiser(chunk * CHUNKS)
    state = _begun(model, optimiser)
    looks = [model]
    for _ in range(CHUNKS):
        model, state = _adam(model, task, state, optimiser, chunk)
        looks.append(model)
    looks.append(_polished(_best(looks, task), task, bfgs))
    return _best(looks, judge)


def train(
    lessons: Sequence[Lesson], budget: Budget | None = None
) -> list[dict[str, Neural]]:
    """Of every lesson `NARX`, trained one step ahead, and `NOE`, trained on from it in
    free runs.

    All lessons have the same channels and lagged variables and as many records of the
    same lengths.
    """
    budget = Budget() if budget is None else budget
    widest = max(lesson.width for lesson in lessons)
    frames, models = [], []
    for one in lessons:
        model = untrained(one.pool, one.data, width=one.width, key=one.key)
        frames.append(model.frame)
        models.append(resized(model, widest))

    def tasks(part: str, horizon: int | None) -> Task:
        pairs = zip(frames, lessons, strict=True)
        made = [task(frame, getattr(one, part), horizon) for frame, one in pairs]
        return side_by_side(made)

    model, one_step = side_by_side(models), tasks("data", 1)
    judge = tasks("validation", 1)
    narx = _stage(model, one_step, judge, budget.adam, budget.bfgs)
    model, judge = narx, tasks("validation", None)
    for horizon in (*budget.horizons, None):
        free = tasks("data", horizon)
        model = _stage(model, free, judge, budget.free_adam, budget.bfgs)
    found = {"NARX": narx, "NOE": model}
    return [
        {kind: resized(member(batch, n), one.width) for kind, batch in found.items()}
        for n, one in enumerate(lessons)
    ]


def neural_run(model: Neural, data: Dataset, *, one_step: bool) -> Trajectories:
    """Outputs in physical units, as `predict` and `simulate` give them."""
    frame = model.frame
    made = task(frame, data, 1 if one_step else None)
    scaled, scored = outputs(model, made), np.asarray(made.counted)
    held = np.asarray((scaled <= frame.lower) | (scaled >= frame.upper)) & scored
    y = np.asarray(scaled * frame.gain[np.array(frame.signals)])
    cut = [(n, slice(len(record))) for n, record in enumerate(data)]
    return Trajectories(
        outputs=tuple(y[at] for at in cut),
        computed=tuple(y[at] for at in cut),
        scored=tuple(scored[at] for at in cut),
        limited=tuple(held[at] for at in cut),
        held=tuple(np.zeros_like(held[at]) for at in cut),
        extrapolated=tuple(np.zeros(len(record), bool) for record in data),
        diverged=tuple(np.array([has_diverged(held[at][:, 0])]) for at in cut),
        names=tuple(data.names),
        output_names=tuple(frame.output_names),
    )


def neural_size(model: Neural) -> dict[str, int]:
    """Parameters, and what one sample costs; standardising is part of the weights."""
    inputs, width = len(model.mean), model.net.width_size
    return {
        "parameters": (inputs + 2) * width + 1,
        "multiplications": (inputs + 1) * width,
        "all": (inputs + 1) * width,
        "exponentials": width,
    }
