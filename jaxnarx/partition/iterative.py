"""Growth in stages: the kernel's run, the choice of a stage, and its network."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.models import (
    AbstractValidity,
    Network,
    OutputModel,
    assemble,
    global_model,
)
from jaxnarx.models import SigmoidTree as SigmoidTreeValidity
from jaxnarx.partition._lolimot import boxes_of_validity, lolimot, validity_of_boxes
from jaxnarx.partition.clusters import move_output
from jaxnarx.partition.fixed import Regions, place_regions
from jaxnarx.partition.local_terms import own_terms
from jaxnarx.partition.prune import prune
from jaxnarx.partition.split import SplitRows
from jaxnarx.partition.stages import choose_stage, free_run_nrmse
from jaxnarx.partition.training_rows import TrainingRows
from jaxnarx.partition.tree import sigmoid_tree, validity_of_stage
from jaxnarx.selection import require_room
from jaxnarx.settings import Lolimot, SigmoidTree

_lolimot = jax.jit(
    lolimot, static_argnames=("max_models", "kind", "worst", "picks", "first")
)

_boxes = jax.jit(validity_of_boxes, static_argnames="kind")

_sigmoid_tree = jax.jit(
    sigmoid_tree, static_argnames=("max_models", "oblique", "steps", "picks", "first")
)


def grow_output(
    training: TrainingRows,
    output: int,
    method: Lolimot | SigmoidTree,
    validation: Dataset | None,
    start: Regions | None = None,
) -> tuple[OutputModel, dict[str, Any]]:
    """The model of one output, and the figures of all stages, from `start` on."""
    begin = None
    if start is not None:
        training, shape, count = place_regions(training, output, start)
        begin = _begin(method, shape, count)
    factor, rows = training.factors[output], training.rows
    if method.local is not None:
        advice = "choose among them first, with `select`, and grow from the selection"
        require_room(len(factor), rows, "local", advice)
    p, y = training.columns(output)
    stages, validity = _run(training, output, p, y, method, begin)
    stages = jax.tree.map(np.asarray, stages)
    sparse = method.local is not None

    frame = assemble(
        training.pool.of_output(output),
        training.data,
        rows.gain,
        [global_model(factor, training.coefficients(output, stages.theta[0, 0]))],
    )

    def stage_network(stage: int, sparse: bool = False) -> Network:
        """The network of a stage; all slots, so that one program serves all stages."""
        slots, count = method.max_models, int(stages.count[stage])
        theta = training.coefficients(output, stages.theta[stage])
        shape = validity(stage, slots)
        model = training.model(output, theta, shape, count, sparse=sparse)
        return dataclasses.replace(frame, models=(model,))

    def score(stage: int) -> float:
        assert validation is not None
        return free_run_nrmse(stage_network(stage), validation)

    best, found = choose_stage(
        stages.count,
        stages.sse,
        stages.effective,
        training.samples(output),
        method,
        score,
    )
    found["stages"] = [stage_network(n, sparse) for n in range(len(found["models"]))]
    found["least"] = float(_fit_settings(training, output, p, method)["least"])
    count = int(stages.count[best])
    if isinstance(method, SigmoidTree) and method.prune:
        tree = jax.device_put(jax.tree.map(lambda a: a[best], stages))
        tree = prune(
            tree, _split_rows(training, output, p, y, method), oblique=method.oblique
        )
        stages, best, count = jax.tree.map(lambda a: a[None], tree), 0, int(tree.count)
        validity = functools.partial(validity_of_stage, stages)
        found["pruned_to"] = count
    if not sparse:
        theta = training.coefficients(output, stages.theta[best, :count])
        model = training.model(output, theta, validity(best, count), count)
        if method.scatter:
            grown = dataclasses.replace(frame, models=(model,))
            model = move_output(training, output, grown, method)
        return model, found
    shape = validity(best, count)
    phi = shape(training.z, jnp.ones(count, bool))
    assert method.local is not None
    theta = own_terms(training, output, phi, method.local)
    return training.model(output, theta, shape, count, sparse=True), found


def _number(value: float | int, dtype: np.dtype) -> Array:
    return jax.device_put(np.asarray(value, dtype))


def _fit_settings(
    training: TrainingRows, output: int, p: Float[Array, "terms rows"], method
):
    """The settings of the fit of local models, the same for every growth."""
    number = functools.partial(_number, dtype=p.dtype)
    picks = None if method.local is None else min(method.local.max_terms, p.shape[0])
    least = picks or p.shape[0] if method.least is None else method.least
    return {
        "ridge": number(method.ridge),
        "least": number(least),
        "picks": picks,
        "first": training.constant(output) if picks else None,
    }


def _split_rows(
    training: TrainingRows, output: int, p, y, method: SigmoidTree
) -> SplitRows:
    smoothness = _number(method.smoothness, p.dtype)
    fitting = _fit_settings(training, output, p, method)
    return SplitRows(p, training.z, y, training.weight(output), smoothness, **fitting)


def _run(
    training: TrainingRows,
    output: int,
    p: Float[Array, "terms rows"],
    y: Float[Array, " rows"],
    method,
    begin,
) -> tuple[Any, Callable[[int, int], AbstractValidity]]:
    """All stages, and a function from stage and slots to its validity functions."""
    number = functools.partial(_number, dtype=p.dtype)
    common = _fit_settings(training, output, p, method) | {
        "max_models": method.max_models
    }
    data = p, training.z, y, training.weight(output)
    if isinstance(method, SigmoidTree):
        smoothness = number(method.smoothness)
        shape = {"oblique": method.oblique, "steps": method.steps}
        tree = _sigmoid_tree(
            *data, smoothness=smoothness, start=begin, **shape, **common
        )
        return tree, functools.partial(validity_of_stage, tree)
    k_sigma, kind = number(method.k_sigma), method.validity
    boxes = _lolimot(
        *data, k_sigma=k_sigma, kind=kind, worst=method.worst, start=begin, **common
    )

    def validity(stage: int, slots: int) -> AbstractValidity:
        low, high = (np.asarray(a)[stage, :slots] for a in (boxes.low, boxes.high))
        return _boxes(kind, low, high, k_sigma)

    return boxes, validity


def _begin(method: Lolimot | SigmoidTree, shape: AbstractValidity, count: int):
    """The regions in use, in the form in which the kernel goes on from them."""
    if count > method.max_models:
        raise SpecError(
            f"the start has {count} local models, more than max_models="
            f"{method.max_models}",
            field="max_models",
        )
    if isinstance(method, Lolimot):
        boxes = boxes_of_validity(method.validity, shape, method.k_sigma)
        return tuple(corner[:count] for corner in boxes)
    if not isinstance(shape, SigmoidTreeValidity):
        raise SpecError(
            f"a tree goes on from a SigmoidTree; the start has {type(shape).__name__}",
            field="start",
        )
    gates = {name: getattr(shape, name)[: count - 1] for name in shape.trained}
    path = shape.path[:count, : count - 1]
    return dataclasses.replace(shape, **gates, path=path)
