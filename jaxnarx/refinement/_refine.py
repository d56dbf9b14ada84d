"""The verb `refine`: train a network on the error of its own runs."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import Progress
from jaxnarx.data import Dataset, Groups, groups
from jaxnarx.errors import SpecError
from jaxnarx.models import Network, set_bounds
from jaxnarx.refinement._stability import first_horizon
from jaxnarx.refinement._stages import Stage, stages
from jaxnarx.refinement.folds import best_position, curve, split_folds
from jaxnarx.refinement.gain_penalty import SignPenalty, sign_penalty
from jaxnarx.refinement.initial import initial_conditions
from jaxnarx.refinement.layout import Layout, freeze, make_layout
from jaxnarx.refinement.prediction import refine_prediction
from jaxnarx.refinement.search import Search, takes_windows
from jaxnarx.refinement.shared_terms import shares_terms
from jaxnarx.refinement.stable import refine_stable
from jaxnarx.refinement.starts import random_start, remedies
from jaxnarx.refinement.training_data import (
    TrainingData,
    make_task,
    require_motion,
    require_window,
)
from jaxnarx.settings import Physics, PredictionError, SimulationError
from jaxnarx.simulation import Prepared, check_records, match_records
from jaxnarx.solution import RESULTS, Solution, tell_precision

__all__ = ["make_task", "refine", "refine_task"]


@guard_arguments
@tell_precision
def refine(
    network: Network,
    data: Dataset | Prepared,
    method: SimulationError | PredictionError | None = None,
    *,
    validation: Dataset | Prepared | None = None,
    trainable: Network | None = None,
    weights: Sequence[float | int] | None = None,
    deviations: Network | None = None,
    physics: Mapping[str, Physics] | None = None,
    progress: Progress | None = None,
    solver: Any = None,
) -> Solution[Network]:
    """Refine coefficients, centres and widths together on simulation error.

    The loss is the mean squared free-run error over the variance of each output, or
    what `method.loss` and `method.box_cox` make of it. Windows started from the
    measurement grow through `method.horizons` to whole records. After every accepted
    step the free run of `validation` is scored by the same loss, and the best network
    by that score is returned: it is never worse there than the start, whether that
    diverges or not. `PredictionError` trains on the one-step error instead, and is
    judged by it.

    `method.train` says in what order: by default the coefficients alone go through
    the windows and the full record before everything moves together. The full record
    begins at the best network by `validation` so far.

    Where the start diverges, windows shorter than its escape still train it; if that
    does not lead to a network that runs, the search begins anew from the least squares
    of the one-step error, from shrunk feedback, and from random starts, in this order.

    Statuses: `ok` (relative decrease below tolerance), `budget_spent` (the usual end:
    free-run fits have nearly flat directions), `no_improvement` (validation stopped
    it), `stalled`, `unidentifiable`, and `start_diverged` when neither the start nor
    any later network runs within its bounds.

    Args:
        network: The start.
        data: Records with its channels, to be trained on, or prepared for it.
        method: `SimulationError` (the default) or `PredictionError`.
        validation: Records that judge each step (default `data`; with `method.folds`
            its groups take turns, see `jaxnarx.data.groups`).
        trainable: A tree of booleans with the network's structure, see `freeze`.
        weights: One number per record of `data`.
        deviations: A tree like the network's: the standard deviation of a Gaussian
            prior around the start for every trained parameter (as it stands in the
            network; infinite for none). The noise it is weighed against is what is left
            at the start of a stage.
        physics: Signs of gains at rest by output (`jnx.identification.Physics`): what
            outputs at rest do against them, at measured samples spread over the data,
            is a penalty of the loss and of what judges each step. Longest time
            constants are not looked at.
        progress: A function called on the host with a dictionary after every accepted
            step.
        solver: In place of Levenberg-Marquardt, which never stores the Jacobian: any
            minimiser or least-squares solver of optimistix, or a transformation of
            optax, which sees batches of random windows of `method.horizons` and no
            whole records. Theirs is the step; schedule, guard and end stay.

    Returns:
        `value` is the best network. `stats["history"]` lists the steps: stage, horizon,
        step, loss, minimised (the loss and the pull of the ridge, which falls from step
        to step), validation, damping, seconds. `stats["remedy"]` and `detail` name what
        has helped a start that diverged.

    Example:
        refined = jnx.refine(network, data, jnx.SimulationError(max_steps=2))
        print(refined.status_name, refined.stats["history"][-1]["loss"])
        bfgs = optimistix.BFGS(rtol=1e-9, atol=1e-9)
        refined = jnx.refine(network, data, solver=bfgs)
    """
    method = SimulationError() if method is None else method
    data = check_records(network, data)
    if isinstance(method, SimulationError) and method.stable:
        bare = dataclasses.replace(method, stable=False)
        given = {"trainable": trainable, "weights": weights, "progress": progress}
        given |= {"solver": solver, "physics": physics}

        def continue_refinement(
            start: Network, deviations: Network | None
        ) -> Solution[Network]:
            given["deviations"] = deviations
            return refine(start, data, bare, validation=validation, **given)

        _require_free(deviations)
        judge = match_records(network, data if validation is None else validation)
        return refine_stable(network, judge, continue_refinement)
    # Of a network that changes they say nothing any more, and with the proof goes what
    # allowed for bounds so wide that nothing is held.
    if network.certificate is not None or network.is_unbounded.any():
        network = set_bounds(network)
    network = dataclasses.replace(network, certificate=None, errors=None)
    settings = {}
    if isinstance(method, SimulationError):
        settings = {"loss": method.loss, "box_cox": method.box_cox}
        settings |= {"corner": method.corner}
    task, _ = make_task(network, data, weights=weights, **settings)
    require_motion(network, task)
    require_window(network, data)
    _require_solver(network, method, solver)
    signs = None
    if physics:
        _require_free_run(method)
        signs = sign_penalty(network, match_records(network, data), physics)
    task = task.with_hidden_starts(network)
    guard = task
    if validation is not None:
        validation = check_records(network, validation)
        rule = {"criterion": task.criterion, "window": network.window}
        guard, _ = make_task(network, validation, **rule)
    trainable = _trained_parameters(network, trainable, method)
    # A prior is one of the coefficients as they stand.
    plain = deviations is None
    if isinstance(method, PredictionError):
        layout = make_layout(network, trainable, method.width_band, centred=plain)
        prior = _prior(layout, deviations)
        return refine_prediction(layout, task, guard, method, prior, progress)
    if method.folds and validation is not None:
        raise SpecError(
            "folds make validation records of the training data; give one or the other",
            field="folds",
        )
    estimated = method.initial_conditions == "estimated"
    initial = initial_conditions(network, task, measured=estimated)
    band = method.width_band
    every = plain and method.shrink > 0
    layout = make_layout(
        network, trainable, band, initial, centred=plain, every=every, dense=True
    )
    layout = dataclasses.replace(layout, shared_terms=shares_terms(layout))
    found = None
    if method.folds:
        found = groups(
            match_records(network, data), folds=method.folds, gap=network.history
        )
    return refine_task(
        layout,
        task,
        guard,
        method,
        progress,
        left_out=found,
        deviations=deviations,
        solver=solver,
        signs=signs,
    )


def refine_task(
    layout: Layout,
    task: TrainingData,
    guard: TrainingData,
    method: SimulationError,
    progress: Progress | None = None,
    *,
    left_out: Groups | None = None,
    deviations: Network | None = None,
    solver: Any = None,
    signs: SignPenalty | None = None,
) -> Solution[Network]:
    """`refine` on prepared data, for those who refine many networks on the same.

    With groups to be left out the length of the search is chosen by them.
    """
    schedules = _schedules(layout, task, method, solver)
    prior = _prior(layout, deviations)

    def search(
        task: TrainingData, guard: TrainingData, limit: int | None = None
    ) -> Search:
        return Search(
            layout,
            task,
            guard,
            method,
            schedules=schedules,
            prior=prior,
            progress=progress,
            limit=limit,
            solver=solver,
            signs=signs,
        )

    if takes_windows(solver) and all(len(s) == 1 for s in schedules.values()):
        found = search(task, guard).solution(RESULTS.too_short)
        detail = f"no record is longer than the windows of {method.horizons} samples"
        return dataclasses.replace(found, detail=detail)
    if left_out is None:
        return _solve(search(task, guard))

    def judge(rest: TrainingData, judged: TrainingData) -> np.ndarray:
        one = search(rest, judged)
        _solve(one)
        own = [row for row in one.log.history if row.get("start", "") == one.winner]
        return curve(one.first.score.on_host, own, one.total)

    folds = split_folds(task, left_out, layout.base.history, guard)
    limit, scores = best_position(folds, judge)
    if not np.isfinite(scores[limit]):
        limit = None
    solution = _solve(search(task, guard, limit))
    solution.stats["cross_validation"] = scores
    solution.stats["limit"] = limit
    return solution


def _require_free(deviations: Network | None) -> None:
    """SpecError for a prior beside a certificate."""
    if deviations is not None:
        raise SpecError(
            "stable and deviations do not go together; leave one out",
            field="deviations",
        )


def _require_free_run(method: SimulationError | PredictionError) -> None:
    """SpecError for signs beside the one-step error."""
    if isinstance(method, PredictionError):
        raise SpecError(
            "physics is a penalty of the free run's error; take SimulationError",
            field="physics",
        )


def _require_solver(
    network: Network, method: SimulationError | PredictionError, solver: Any
) -> None:
    """SpecError for a solver that does not go with the method or the network."""
    windows = takes_windows(solver)
    if network.hidden and (windows or isinstance(method, PredictionError)):
        raise SpecError(
            "hidden channels are trained on free runs of whole records: take "
            "SimulationError and no transformation of optax",
            field="method",
        )
    if isinstance(method, PredictionError):
        if solver is None:
            return
        raise SpecError(
            "PredictionError has a solver of its own; solver is for SimulationError",
            field="solver",
        )
    if windows and method.initial_conditions != "measured":
        raise SpecError(
            "a transformation of optax starts every window from the measurement; take "
            'initial_conditions="measured" with it',
            field="initial_conditions",
        )
    if windows and not method.horizons:
        raise SpecError(
            "a transformation of optax needs at least one horizon, the length of its "
            "windows",
            field="horizons",
        )


def _schedules(
    layout: Layout, task: TrainingData, method: SimulationError, solver: Any
) -> dict[str, list[Stage]]:
    """The orders of training that are tried, by name."""
    if layout.base.hidden:
        # Windows would begin at values of hidden channels that nobody knows.
        horizons = []
    elif method.horizons == "auto":
        first = first_horizon(layout.base, task.drive, task.masks)
        horizons = [first * 3**n for n in range(20)]
    else:
        horizons = list(method.horizons)
    horizons = [h for h in horizons if h < task.longest]
    # Where only one kind is trained, there is no order in which to train the two.
    both = layout.coefficients().size and layout.partition().size
    train = method.train if both else "joint"
    steps = 0 if takes_windows(solver) else method.max_steps
    return {
        order: stages(horizons, method.window_steps, steps, staged=order == "staged")
        for order in (("staged", "joint") if train == "either" else (train,))
    }


def _trained_parameters(
    network: Network,
    trainable: Network | None,
    method: SimulationError | PredictionError,
) -> Network | None:
    """The parameters that are trained, of these what `method.train` moves."""
    kinds = ("coefficients", "partition")
    train = getattr(method, "train", "joint")
    if train not in kinds:
        return trainable
    own = freeze(network, **{kind: kind == train for kind in kinds})
    if trainable is None:
        return own
    return jax.tree.map(lambda a, b: bool(a and b), own, trainable)


def _prior(layout: Layout, deviations: Network | None) -> np.ndarray | None:
    """One over the standard deviation of every trained parameter."""
    if deviations is None:
        return None
    if jax.tree.structure(deviations) != jax.tree.structure(layout.base):
        raise SpecError(
            "deviations must have the structure of the network; make it with "
            "eqx.tree_at on the network itself",
            field="deviations",
        )
    shapes = [
        [np.shape(leaf) for leaf in jax.tree.leaves(tree)]
        for tree in (deviations, layout.base)
    ]
    if shapes[0] != shapes[1]:
        raise SpecError(
            "deviations must have the shapes of the network's arrays, one standard "
            "deviation for every parameter",
            field="deviations",
        )
    value = np.asarray(layout.flat(deviations))[: layout.parameters]
    if not np.all(value > 0):
        raise SpecError(
            "deviations of trained parameters must be positive, or inf for no prior",
            field="deviations",
        )
    return np.pad(1.0 / value, (0, layout.low.shape[0] - layout.parameters))


def _solve(search: Search) -> Solution[Network]:
    """Run the schedules from one start or from several, with remedies."""
    method, layout = search.method, search.layout
    starts = [("", search.start)]
    rng = np.random.default_rng(method.seed)
    for n in range(1, method.starts):
        moved = random_start(layout, search.task, search.start, rng)
        starts.append((f"random start {n}", moved))
    status = RESULTS.budget_spent
    first = next(iter(search.schedules))
    for way in search.schedules:
        score = search.score
        named = [(", ".join(filter(None, (n, way))), u) for n, u in starts]
        ended = search.run(way, starts if way == first else named)
        if way == first or search.score < score:
            status = ended
    if search.diverged and search.total:
        for name, u in remedies(search):
            status = search.run(first, [(name, u)])
            if not search.diverged:
                break
    return search.solution(status)
