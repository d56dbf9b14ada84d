"""Rounds of a search for maps; one that was stopped goes on from a file."""

import hashlib
import io
import json
import os
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxnarx.arrays import Progress
from jaxnarx.calibration.lagrangian import (
    GROWTH,
    LEAST_PENALTY,
    MOST_PENALTY,
    evaluate_merit,
    first_penalty,
    minimise,
)
from jaxnarx.calibration.problem import CalibrationProblem, FreeNumbers, Merit
from jaxnarx.errors import SpecError
from jaxnarx.files import write_whole
from jaxnarx.settings import CalibrationSearch
from jaxnarx.solution import RESULTS

RELAXED_ROUNDS = 3
"""Rounds in which only limits count, where they cannot all be kept."""
STATE_FILE = "calibration.npz"


class MapSearch:
    """Rounds of a search, and the best so far."""

    def __init__(
        self,
        problem: CalibrationProblem,
        search: CalibrationSearch,
        free: tuple[FreeNumbers, ...],
        folder: str | os.PathLike[str] | None,
        progress: Progress | None,
    ):
        self.problem, self.search, self.progress = problem, search, progress
        self.path = None if folder is None else Path(folder) / STATE_FILE
        merit = evaluate_merit(problem, free)
        self.multipliers = np.zeros(merit.inequalities.shape)
        self.penalty = first_penalty(merit)
        self.free = self.best = free
        self.merit = self._rank(merit)
        self.begin_merit = self.now = self.merit
        self.broken, self.rounds, self.steps = np.inf, 0, 0
        self.history: list[dict[str, Any]] = []

    def _rank(self, merit: Any) -> tuple[float, float]:
        """How far limits are broken beyond what is allowed, then the objective."""
        g = np.asarray(merit.inequalities)
        worst = float(np.max(g, initial=0.0))
        objective = float(merit.objective)
        if not (np.isfinite(worst) and np.isfinite(objective)):
            return np.inf, np.inf
        return max(worst - self.search.tolerance, 0.0), objective

    def run(self) -> RESULTS:
        """All rounds; `best` and `multipliers` are then those of their end, multipliers
        of the rounds in which the objective counted."""
        self._resume()
        status = RESULTS.budget_spent
        while self.rounds < self.search.rounds:
            last = self.now
            self._round(1.0)
            gain = abs(last[1] - self.now[1])
            if not self.now[0] and gain < self.search.tolerance * (1 + abs(last[1])):
                status = RESULTS.ok
                break
        if self.merit[0] > 0:
            prices = self.multipliers
            for _ in range(RELAXED_ROUNDS):
                self._round(0.0)
            self.multipliers = prices
            status = RESULTS.infeasible if self.merit[0] > 0 else RESULTS.budget_spent
        elif not self.merit < self.begin_merit:
            status = RESULTS.no_improvement
        return status

    def _round(self, wanted: float) -> None:
        found = minimise(
            self.problem, self.free, self.multipliers, self.penalty, wanted
        )
        self.rounds += 1
        self.steps += found.steps
        rank = self.now = self._rank(found.merit)
        if np.isfinite(rank[1]):
            self.free = found.free
            if rank < self.merit or (not wanted and rank[0] < self.merit[0]):
                self.best, self.merit = found.free, rank
            self._push(found.merit)
        else:
            self.free, self.penalty = self.best, LEAST_PENALTY
        row = {"round": self.rounds, "of": self.search.rounds}
        row |= {"objective": float(found.merit.objective), "steps": found.steps}
        worst = np.max(np.asarray(found.merit.inequalities), initial=0.0)
        row |= {"worst": float(worst), "runs": found.runs}
        self.history.append(row)
        if self.progress is not None:
            self.progress(row)
        self._keep()

    def _push(self, found: Merit) -> None:
        """Multipliers of the next round, and its penalty."""
        g = np.asarray(found.inequalities)
        self.multipliers = np.maximum(self.multipliers + self.penalty * g, 0.0)
        broken = float(np.max(g, initial=0.0))
        if broken > 0.25 * self.broken or broken > self.search.tolerance:
            self.penalty = min(self.penalty * GROWTH, MOST_PENALTY)
        self.broken = broken

    @property
    def _key(self) -> str:
        """Digest of the problem that a state on disk belongs to."""
        leaves = [np.asarray(a).tobytes() for a in jax.tree.leaves(self.problem)]
        told = repr((self.problem.objective, self.problem.limits, self.search))
        return hashlib.sha256(b"".join(leaves) + told.encode()).hexdigest()

    def _keep(self) -> None:
        if self.path is None:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        held = io.BytesIO()
        arrays = {f"free{n}": a for n, a in enumerate(jax.tree.leaves(self.free))}
        arrays |= {f"best{n}": a for n, a in enumerate(jax.tree.leaves(self.best))}
        numbers = np.array([self.penalty, self.broken, *self.merit, *self.now])
        counts = np.array([self.rounds, self.steps])
        rest = {"multipliers": self.multipliers, "numbers": numbers, "counts": counts}
        key = np.frombuffer(self._key.encode(), np.uint8)
        table = {k: np.asarray(a) for k, a in (arrays | rest).items()}
        told = np.frombuffer(json.dumps(self.history).encode(), np.uint8)
        np.savez(held, key=key, history=told, **table)  # pyright: ignore[reportArgumentType]
        write_whole(self.path, held.getvalue())

    def _resume(self) -> None:
        """Go on where an earlier call was stopped."""
        if self.path is None or not self.path.exists():
            return
        with np.load(self.path) as held:
            if bytes(held["key"]).decode() != self._key:
                raise SpecError(
                    f"{self.path} is of another calibration; take another folder",
                    field="folder",
                )
            tree = jax.tree.structure(self.free)
            count = tree.num_leaves

            def read(kind: str) -> tuple[FreeNumbers, ...]:
                leaves = [jnp.asarray(held[f"{kind}{n}"]) for n in range(count)]
                return jax.tree.unflatten(tree, leaves)

            self.free, self.best = read("free"), read("best")
            self.multipliers = np.asarray(held["multipliers"])
            self.penalty, self.broken, *merit = held["numbers"].tolist()
            self.merit, self.now = (merit[0], merit[1]), (merit[2], merit[3])
            self.rounds, self.steps = held["counts"].tolist()
            self.history = json.loads(bytes(held["history"]))
