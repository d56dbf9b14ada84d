"""Select, grow, refine and score as one function of arrays, and that for many lanes."""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.models import AbstractValidity, LocalModels, Network, OutputModel
from jaxnarx.partition import scatter_partition
from jaxnarx.refinement import Layout, make_layout
from jaxnarx.regressors import evaluate
from jaxnarx.settings import PredictionError
from jaxnarx.simulation import RunInputs, drive_from_signals
from jaxnarx.solution import STATUS_NAMES
from jaxnarx.sweep.identify.engine_data import Member, Part
from jaxnarx.sweep.identify.grow_step import Divided, GrowthRows, divide
from jaxnarx.sweep.identify.refine_step import EngineTraining, Trained, schedule, train
from jaxnarx.sweep.identify.score import Score, score
from jaxnarx.sweep.identify.select_step import Chosen, choose
from jaxnarx.sweep.identify.settings import Settings
from jaxnarx.sweep.identify.shared_tables import Frame


class Outcome(eqx.Module):
    """The end of one engine under one case.

    `scores` are by part, of shape (start and end, one step and free run); coefficients
    and validity those of the end. `history` holds the training loss after every turn of
    the refinement, `guard` the best loss of the records that judge; `shrunk` is the
    factor on the feedback of a start that diverged, one for none.
    """

    status: Int[Array, "*lanes"]
    chosen: Chosen
    models: Int[Array, "*lanes"]
    theta: Float[Array, "*lanes models terms"]
    validity: AbstractValidity
    scores: dict[str, Score]
    steps: Int[Array, "*lanes"]
    history: Float[Array, "*lanes turns"]
    guard: Float[Array, "*lanes turns"]
    shrunk: Float[Array, "*lanes"]


@eqx.filter_jit
def identify_lanes(
    frame: Frame, members: Member, settings: Settings, *, at_once: int
) -> Outcome:
    """Every lane of stacked members and settings, `at_once` of them side by side.

    One compiled program for every frame and shape; 1 takes one lane after the other.
    """
    lane = partial(identify_lane, frame)
    size = None if at_once == 1 else at_once
    return jax.lax.map(lambda a: lane(*a), (members, settings), batch_size=size)


def identify_lane(frame: Frame, member: Member, settings: Settings) -> Outcome:
    """One engine under one case."""
    drive = _drive(member, member.train)
    v = jnp.moveaxis(drive.v, 1, 0).reshape(drive.v.shape[1], -1)
    y = drive.measured.reshape(-1)
    weight = jnp.asarray(member.weight).reshape(-1)
    variables = jnp.asarray(member.variables)
    chosen = choose(frame, v, y, weight, variables, settings)
    p = jnp.where(chosen.used[:, None], evaluate(chosen.factor, v), 0.0)
    rows = GrowthRows(p, _scheduling_values(member.network, drive), y, weight)
    least = jnp.sum(chosen.used)
    divided = divide(frame.shape, rows, least, settings)
    network = _network(member.network, chosen, divided)
    trained, start, layout = _refine(frame, member, network, drive, rows, settings)
    ends = jnp.stack([start, trained.u])
    scores = _scores(member, layout, drive, ends)
    model = layout.place(trained.u).models[0]
    return Outcome(
        _status(chosen, trained, scores, settings),
        chosen,
        divided.count,
        model.local.coefficient,
        model.validity,
        scores,
        trained.accepted,
        trained.loss,
        trained.judged,
        trained.factor,
    )


def _drive(member: Member, part: Part) -> RunInputs:
    return drive_from_signals(
        member.network, jnp.asarray(part.signals), jnp.asarray(part.valid)
    )


def _scheduling_values(network: Network, drive: RunInputs) -> Float[Array, "dims rows"]:
    """Scaled scheduling variables of all rows."""
    model = network.models[0]
    dims, rows = len(model.offset), drive.measured.size
    x = jnp.moveaxis(drive.x[0], 1, 0).reshape(dims, rows)
    return (x - model.offset[:, None]) / model.span[:, None]


def _network(network: Network, chosen: Chosen, divided: Divided) -> Network:
    """The member's network with the model that was grown."""
    models, slots = divided.theta.shape
    local = LocalModels(
        chosen.factor,
        jnp.broadcast_to(jnp.arange(slots), (models, slots)),
        jnp.broadcast_to(chosen.used, (models, slots)),
        divided.theta,
    )
    active = jnp.arange(models) < divided.count
    frame = network.models[0]
    model = OutputModel(
        frame.scheduling, frame.offset, frame.span, divided.validity, active, local
    )
    return dataclasses.replace(network, models=(model,))


def trainable(network: Network) -> Network:
    """Coefficients and partition, whatever the count of active models."""
    tree = jax.tree.map(lambda _: False, network)

    def select_leaves(n: Network) -> list:
        return [n.models[0].local.coefficient, *n.models[0].validity.parameters]

    return eqx.tree_at(select_leaves, tree, [True] * len(select_leaves(network)))


def _refine(
    frame: Frame,
    member: Member,
    network: Network,
    drive: RunInputs,
    rows: GrowthRows,
    settings: Settings,
) -> tuple[Trained, Float[Array, " params"], Layout]:
    """The end and the start of the refinement, as vectors of its layout."""
    refine = frame.shape.refine
    layout = make_layout(network, trainable(network), refine.width_band)
    u = scatter_partition(
        layout,
        network,
        (rows.p, rows.z, rows.y, rows.weight),
        scatter=jnp.asarray(settings.scatter),
        seed=jnp.asarray(settings.seed),
        ridge=jnp.asarray(settings.growth_ridge),
    )
    weight = _weight(member.train, drive)
    if isinstance(refine, PredictionError):
        weight = jnp.where(jnp.asarray(member.train.anchors)[..., None], weight, 0.0)
    judging = member.train if member.validation is None else member.validation
    guard = drive if member.validation is None else _drive(member, judging)
    training = EngineTraining(
        layout,
        drive,
        member.train,
        weight,
        guard,
        judging,
        _weight(judging, guard),
        *_trained_parameters(layout, settings),
    )
    return train(training, u, settings, schedule(refine, frame.shape.steps)), u, layout


def _trained_parameters(
    layout: Layout, settings: Settings
) -> tuple[Bool[Array, " params"], Bool[Array, " params"], Bool[Array, ""]]:
    """The parameters that the case trains, those of them that come first, and whether
    these are fewer: a single model has no partition to wait for.
    """
    at = jnp.arange(layout.parameters)
    own = at < layout.coefficients().size
    moving = jnp.where(
        own, jnp.asarray(settings.coefficients), jnp.asarray(settings.partition)
    )
    several = jnp.sum(layout.base.models[0].active) > 1
    staged = jnp.asarray(settings.staged) & several & bool(layout.partition().size)
    return moving, moving & (own | ~staged), staged


def _weight(part: Part, drive: RunInputs) -> Float[Array, "records time outputs"]:
    """Weights that make mean squared NRMSE, by the output's spread in this part."""
    counted = jnp.asarray(part.scored)
    own = counted.astype(drive.measured.dtype)
    total = jnp.maximum(jnp.sum(own), 1.0)
    mean = jnp.sum(own * drive.measured) / total
    square = jnp.sum(own * (drive.measured - mean) ** 2) / total
    return own / (total * jnp.where(square > 0, square, 1.0))


def _scores(
    member: Member,
    layout: Layout,
    drive: RunInputs,
    ends: Float[Array, "2 params"],
) -> dict[str, Score]:
    """Scores of every part: start and end, one step and free run."""
    parts = {"train": (member.train, drive)}
    for name, part in (("validation", member.validation), ("test", member.test)):
        if part is not None:
            parts[name] = part, _drive(member, part)

    def score_part(part: Part, drive: RunInputs) -> Score:
        def one(turn):
            u, free = turn
            return score(layout.place(u), drive, part, free)

        turns = jnp.repeat(ends, 2, axis=0), jnp.asarray([False, True, False, True])
        found = jax.lax.map(one, turns)
        return jax.tree.map(lambda a: a.reshape(2, 2), found)

    return {name: score_part(*both) for name, both in parts.items()}


def _status(
    chosen: Chosen, trained: Trained, scores: dict[str, Score], settings: Settings
) -> Int[Array, ""]:
    """The worst that can be said, as the code of a status."""
    code = {name: jnp.asarray(n) for n, name in enumerate(STATUS_NAMES)}
    limit = float(jnp.finfo(chosen.condition.dtype).eps) ** -0.5
    lost = jnp.any(jnp.stack([s.diverged[1, 1] for s in scores.values()]))
    asked = jnp.asarray(settings.steps) > 0
    asked &= jnp.asarray(settings.coefficients) | jnp.asarray(settings.partition)
    same = ~trained.best.better(trained.start)
    status = jnp.where(asked & same, code["no_improvement"], code["ok"])
    collinear = ~(chosen.condition <= limit) | ~jnp.any(chosen.used)
    status = jnp.where(collinear, code["unidentifiable"], status)
    status = jnp.where(lost, code["diverged"], status)
    never = trained.start.diverged & trained.best.diverged
    return jnp.where(never, code["start_diverged"], status)
