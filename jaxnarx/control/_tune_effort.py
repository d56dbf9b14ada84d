"""The verb `tune_effort`: what a controller's moves have to cost, tried on plants.

A limit of an output is kept by what a network foresees. One that errs where an output
comes near its limit has it broken by commands that are cheap to move, and the networks
of a jackknife tell so before an engine does.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require
from jaxnarx.control._close_loop import close_loop
from jaxnarx.control.controller import Controller
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError
from jaxnarx.solution import RESULTS, Solution

FACTORS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
EQUAL_SHARE = 0.05
"""Share of the least error within which the largest effort is taken."""
KEPT = 0.999
"""Share of the samples in which limits are to be kept, with any plant."""
SKIPPED = 20
"""Samples at the begin of a run that do not count."""


@guard_arguments
def tune_effort(
    controller: Controller,
    plants: Sequence[Any],
    references: Dataset,
    *,
    factors: Sequence[float] = FACTORS,
    **loop: Any,
) -> Solution[Controller]:
    """The controller with efforts that serve several plants.

    A controller whose model is a little wrong swings where its moves cost too little,
    and is slow where they cost too much. Its efforts are multiplied by every factor in
    turn, and it is run against every plant: networks of other parts of the records
    (`jnx.confidence.jackknife`), sister engines, or the network itself. Limits come
    first: a factor qualifies that keeps them in 99.9 % of the samples with every plant,
    as all larger factors do; where none does, those qualify that keep them best. Then
    the tracking error counts, the mean of the targets' NRMSE, of the worst plant; of
    factors within 5 % of the least the largest is taken, for its commands are the
    calmest.

    Args:
        controller: From `jnx.control.mpc`.
        plants: As `close_loop` takes them, at least one. Networks of one structure
            share one program.
        references: Records that it is run over, as `close_loop` takes them; the first
            20 samples of each do not count.
        factors: What efforts are multiplied by.
        loop: Other arguments of `close_loop`: preview, noise, seed, every, start.

    Returns:
        `value` is the controller. `stats`: `factor`, the one that was taken; `factors`;
        `nrmse`, of every factor, plant and target, infinite where the loop diverges;
        `kept`, of every factor and plant, the share of the samples within the limits.
        Status `ok`; `diverged` where with every factor some plant diverges: the
        controller is the given one then.

    Raises:
        SpecError: no plant, or a factor that is not positive; what `close_loop` raises.
        DataError: references that do not move behind the first samples.

    Example:
        free = {"a": jnx.control.Command(rate=2.0)}
        controller = jnx.control.mpc(network, free, ["y"], horizon=8).value
        tuned = jnx.control.tune_effort(controller, [network], data, factors=(1.0, 3.0))
        print(tuned.stats["factor"])
    """
    tried = np.array(sorted(factors), float)
    require(len(plants) > 0, "plants", "efforts are tuned against a plant at least")
    require(
        len(tried) > 0 and bool(np.all(np.isfinite(tried) & (tried > 0))),
        "factors",
        f"factors must be positive and finite, got {tuple(factors)}",
    )
    errors = np.full((len(tried), len(plants), len(controller.target_names)), np.inf)
    kept = np.zeros(errors.shape[:2])
    for k, factor in enumerate(tried):
        one = _with_effort(controller, factor)
        for n, plant in enumerate(plants):
            run = close_loop(one, plant, references, **loop)
            if not run.is_okay:
                continue
            errors[k, n] = run.value.nrmse(SKIPPED)
            if not np.isfinite(errors[k, n]).all():
                raise DataError(
                    "a target has a reference that does not move behind the first "
                    f"{SKIPPED} samples of a record: its errors have no scale"
                )
            kept[k, n] = run.value.share_kept(SKIPPED)
    worst = errors.mean(axis=2).max(axis=1)
    stats = {"factors": tried, "nrmse": errors, "kept": kept, "factor": 1.0}
    if not np.isfinite(worst).any():
        told = "with every factor a loop diverges; the efforts are as they were"
        return Solution(controller, RESULTS.diverged, stats, told)
    fits = keep_limits(kept.min(axis=1), np.isfinite(worst))
    least = worst[fits].min()
    chosen = int(np.flatnonzero(fits & (worst <= (1 + EQUAL_SHARE) * least)).max())
    stats["factor"] = float(tried[chosen])
    told = (
        f"efforts times {tried[chosen]:g}: tracking error {worst[chosen]:.3g} at worst"
    )
    if controller.bounded:
        share = 100 * kept[chosen].min()
        told += f", limits kept in {share:.4g} % of the samples at least"
    return Solution(_with_effort(controller, tried[chosen]), RESULTS.ok, stats, told)


def keep_limits(
    kept: Float[np.ndarray, " factors"], runs: Bool[np.ndarray, " factors"]
) -> Bool[np.ndarray, " factors"]:
    """Factors that keep limits, as all larger ones do: below such a one, a factor may
    keep them by chance. Those that keep them best where there is none; of factors
    whose loops do not diverge."""
    larger = np.where(runs, kept, np.inf)[::-1]
    fits = runs & (np.minimum.accumulate(larger)[::-1] >= KEPT)
    return fits if fits.any() else runs & (kept >= kept[runs].max())


def _with_effort(controller: Controller, factor: float) -> Controller:
    return eqx.tree_at(lambda c: c.effort, controller, controller.effort * factor)
