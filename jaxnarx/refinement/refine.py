"""The verb `refine`: train a network on the error of its own free run."""

import dataclasses
import time as clock
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxnarx.data import Dataset, match_channels
from jaxnarx.data.batch import stack
from jaxnarx.errors import DataError
from jaxnarx.methods import SimulationError
from jaxnarx.models import Network
from jaxnarx.refinement import levenberg
from jaxnarx.refinement.layout import Layout, make_layout
from jaxnarx.refinement.normal import loss, normal_equations
from jaxnarx.simulation import (
    Drive,
    Masks,
    first_anchor,
    has_diverged,
    make_drive,
    make_masks,
    run,
)
from jaxnarx.solution import NAMES, RESULTS, Solution, code

ROUNDING = 1e-24
"""Loss (mean squared NRMSE) that is nothing but rounding errors of float64."""

Progress = Callable[[dict[str, Any]], None]


@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """A dataset prepared for runs of one network: the loss is mean squared NRMSE."""

    drive: Drive
    masks: Masks
    weight: Float[Array, "records time outputs"]

    def anchors(self, horizon: int | None) -> Bool[Array, "records time"]:
        """Restarts every `horizon` samples where the history is valid; None: one."""
        anchor = first_anchor(self.masks)
        if horizon is not None:
            time = np.arange(anchor.shape[1])[None]
            every = (time - self.masks.start[:, None]) % horizon == 0
            anchor = anchor | (every & self.masks.anchors)
        return jnp.asarray(anchor)


def make_task(
    network: Network, data: Dataset, spread: Float[np.ndarray, " outputs"] | None = None
) -> tuple[Task, Float[np.ndarray, " outputs"]]:
    """Prepare `data`; residuals are divided by `spread`, the outputs' standard
    deviation.

    The spread is that of the data themselves unless it is given (scaled units).
    """
    batch = stack(data)
    masks = make_masks(network, batch)
    if not masks.scored.any():
        raise DataError(
            f"no record has {network.history} valid samples in a row and one more to "
            "score; refinement has nothing to work on"
        )
    drive = make_drive(network, batch)
    if spread is None:
        y = np.asarray(drive.measured)
        columns = [y[..., o][masks.scored[..., o]] for o in range(y.shape[2])]
        spread = np.array([c.std() for c in columns], y.dtype)
        spread = np.where(spread > 0, spread, 1.0)
    count = np.maximum(masks.scored.sum(axis=(0, 1)), 1)
    weight = masks.scored / (count * spread**2 * len(spread))[None, None]
    return Task(drive, masks, jnp.asarray(weight.astype(spread.dtype))), spread


def refine(
    network: Network,
    data: Dataset,
    method: SimulationError | None = None,
    *,
    validation: Dataset | None = None,
    trainable: Network | None = None,
    progress: Progress | None = None,
) -> Solution[Network]:
    """Refine coefficients, centres and widths together on simulation error.

    The loss is the mean squared free-run error over the variance of each output.
    Windows started from the measurement grow through `method.horizons` to whole
    records. After every accepted step the free run of `validation` (default: of `data`)
    is scored, and the best network by that score is returned: it is never worse there
    than the start.

    `trainable` is a tree of booleans with the network's structure. `progress` is called
    on the host with a dictionary after every accepted step. `stats["history"]` lists
    these: stage, horizon, step, loss, validation, damping, seconds.

    Statuses: `ok` (relative decrease below tolerance), `budget_spent` (the usual end:
    free-run fits have nearly flat directions), `no_improvement` (validation stopped
    it), `stalled`, `unidentifiable`, and `start_diverged` when neither the start nor
    any later network runs within its bounds.
    """
    method = SimulationError() if method is None else method
    data, _ = match_channels(data, network.channels)
    task, spread = make_task(network, data)
    guard = task
    if validation is not None:
        validation, _ = match_channels(validation, network.channels)
        guard, _ = make_task(network, validation, spread)
    layout = make_layout(network, trainable, method.width_band)
    return refine_task(layout, task, guard, method, progress)


def refine_task(
    layout: Layout,
    task: Task,
    guard: Task,
    method: SimulationError,
    progress: Progress | None = None,
) -> Solution[Network]:
    """`refine` on prepared data, for those who refine many networks on the same."""
    return _Search(layout, task, guard, method, progress).solve()


def _on_host(equations) -> tuple[float, np.ndarray, np.ndarray]:
    value, gradient, gram = equations
    return float(value), np.asarray(gradient), np.asarray(gram)


class _Search:
    """Bookkeeping of one refinement on the host: stages, the guard and the history."""

    def __init__(self, layout: Layout, task, guard, method: SimulationError, progress):
        self.layout, self.task, self.guard = layout, task, guard
        self.method, self.progress = method, progress
        self.history: list[dict[str, Any]] = []
        self.begin = clock.perf_counter()
        self.best = np.asarray(layout.gather(layout.base))
        self.start_score, self.start_diverged = self._judge(self.best)
        self.score, self.diverged = self.start_score, self.start_diverged
        self.since = self.passed = 0
        self.total = method.window_steps * len(method.horizons) + method.max_steps

    def _judge(self, u: np.ndarray) -> tuple[float, bool]:
        """Free-run loss on the guard's records, and whether any of them diverges."""
        network = self.layout.place(jnp.asarray(u))
        y = run(network, self.guard.drive, self.guard.anchors(None))
        error = jnp.sum(self.guard.weight * (y - self.guard.drive.measured) ** 2)
        value = np.asarray(y)
        held = (value <= np.asarray(network.lower)) | (
            value >= np.asarray(network.upper)
        )
        held &= self.guard.masks.scored
        bad = any(
            has_diverged(held[n, self.guard.masks.scored[n, :, o], o])
            for n in range(held.shape[0])
            for o in range(held.shape[2])
        )
        return float(error), bad

    def _consider(self, u: np.ndarray) -> tuple[float, bool]:
        """Keep `u` if its guard score is the best; a network that runs beats none."""
        score, diverged = self._judge(u)
        better = (diverged, score) < (self.diverged, self.score)
        if better:
            self.best, self.score, self.diverged, self.since = u, score, diverged, 0
        else:
            self.since += 1
        return score, diverged

    def _problem(self, horizon: int | None) -> levenberg.Problem:
        anchors = self.task.anchors(horizon)
        args = (self.task.drive, anchors, self.task.weight)
        return levenberg.Problem(
            lambda u: float(loss(self.layout, jnp.asarray(u), *args)),
            lambda u: _on_host(normal_equations(self.layout, jnp.asarray(u), *args)),
            np.asarray(self.layout.wall),
        )

    def _stage(self, u: np.ndarray, horizon: int | None, steps: int):
        """Up to `steps` accepted steps at one horizon; returns the end and its
        status.
        """
        if not steps:
            return u, RESULTS.budget_spent
        problem = self._problem(horizon)
        state = levenberg.init(problem, u)
        pull = self.method.ridge * np.diagonal(state.gram)
        small = self.since = 0
        for n in range(steps):
            state, status = levenberg.step(problem, state, pull, u)
            if status != RESULTS.ok:
                # Where no step promises a decrease, or at a loss of rounding errors
                # alone, the search has converged; it stalls only short of that.
                arrived = levenberg.promise(state, pull, u) < 1e-10 * state.loss
                if status == RESULTS.stalled and (arrived or state.loss < ROUNDING):
                    status = RESULTS.ok
                return state.u, status
            score, diverged = self._consider(state.u)
            self._tell(horizon, n, state, score, diverged)
            small = small + 1 if state.gain < self.method.tolerance else 0
            if small >= 2:
                return state.u, RESULTS.ok
            if horizon is None and self.since >= self.method.patience:
                return state.u, RESULTS.no_improvement
        return state.u, RESULTS.budget_spent

    def _tell(self, horizon, n: int, state: levenberg.State, score, diverged) -> None:
        row = {
            "step": len(self.history) + 1,
            "of": self.total,
            "done": self.passed + n + 1,
            "stage": "full record" if horizon is None else f"{horizon} samples",
            "horizon": horizon,
            "stage_step": n + 1,
            "loss": state.loss,
            "validation": score,
            "diverged": diverged,
            "damping": state.damping,
            "seconds": clock.perf_counter() - self.begin,
        }
        self.history.append(row)
        if self.progress is not None:
            self.progress(row)

    def solve(self) -> Solution[Network]:
        u, status = self.best, RESULTS.budget_spent
        longest = int(self.task.masks.scored.any(axis=2).sum(axis=1).max())
        horizons = [h for h in self.method.horizons if h < longest]
        for horizon in horizons:
            u, _ = self._stage(u, horizon, self.method.window_steps)
            self.passed += self.method.window_steps
        u, status = self._stage(u, None, self.method.max_steps)
        return self._solution(status)

    def _solution(self, status: RESULTS) -> Solution[Network]:
        network = self.layout.place(jnp.asarray(self.best))
        detail = f"free-run loss {self.start_score:.4g} -> {self.score:.4g}"
        if self.diverged:
            status = RESULTS.start_diverged if self.start_diverged else status
            detail += "; no network was found that runs within its bounds"
        elif self.start_diverged:
            detail += "; the start diverged, growing horizons led to one that does not"
        stats = {
            "history": self.history,
            "loss": self.score,
            "loss_start": self.start_score,
            "start_diverged": self.start_diverged,
            "steps": len(self.history),
            "parameters": int(self.best.size),
            "seconds": clock.perf_counter() - self.begin,
            "end": NAMES[int(code(status))],
        }
        return Solution(network, status, stats, detail)
