"""The verb `optimise`: maps of a control unit, optimised through the free run."""

import dataclasses
import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import Progress, program
from jaxnarx.calibration.lagrangian import (
    GROWTH,
    LEAST_PENALTY,
    MOST_PENALTY,
    evaluate_merit,
    first_penalty,
    minimise,
)
from jaxnarx.calibration.problem import (
    CalibrationProblem,
    CycleRun,
    FreeNumbers,
    Merit,
    begin_numbers,
    measure_run,
    place_numbers,
    run_cycle,
)
from jaxnarx.calibration.result import CalibratedMap, Calibration, MeasureRow
from jaxnarx.calibration.setup import join_plants, make_problem
from jaxnarx.calibration.tables import LookupTable
from jaxnarx.data import Channel, Dataset
from jaxnarx.errors import SpecError
from jaxnarx.files import write_whole
from jaxnarx.formatting import list_names
from jaxnarx.settings import TIME, Calibratable, CalibrationSearch, CycleLimit, Measure
from jaxnarx.solution import RESULTS, Solution

RELAXED_ROUNDS = 3
"""Rounds in which only limits count, where they cannot all be kept."""
TELLS_NOTHING = 1e-12
"""Largest change of any measure by a map on which nothing depends."""
SCALE_SHARE = 0.2
"""Share of a measure's value at the start that a limit is measured by at least."""
STATE_FILE = "calibration.npz"


@guard_arguments
def optimise(
    plant: Any,
    cycle: Dataset,
    maps: Mapping[str, Calibratable],
    objective: Sequence[Measure],
    limits: Sequence[CycleLimit] = (),
    *,
    search: CalibrationSearch | None = None,
    every: int = 1,
    begin: Calibration | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Solution[Calibration]:
    """Maps, curves and scalars of a control unit, optimised over a cycle.

    Minimises a weighted sum of measures of the free run, each over its value with the
    calibration to begin with, under limits, by gradients through the run: an augmented
    Lagrangian with L-BFGS-B (`CalibrationSearch`). A network with a domain is kept
    where it knows the plant. Peaks are smooth in the search, and true in what is told.

    Args:
        plant: A network that computes all outputs it looks at, a virtual engine, or a
            `FunctionPlant`. Or a list of several of one structure, such as draws of a
            fleet (`jnx.fleet.draw_engines`): the objective is their mean, limits must
            be kept by the share `search.draws` of them.
        cycle: Records with every input of the plant that no map sets, and with signals
            that maps or measures look at; at the plant's sample time. Every row counts.
        maps: What sets which input, by the input's name.
        objective: What is to be small.
        limits: What must be kept.
        search: Settings of the search.
        every: Events of a virtual engine in one sample.
        begin: A calibration of the same maps from which the search sets out; what it is
            measured by stays that of `maps`.
        folder: Folder that keeps where the search stands after every round: the same
            call goes on there.
        progress: A function called after every round with `round` and how many there
            are at most (`of`), `objective`, `worst`, the largest share by which a limit
            is broken, and `steps`.

    Returns:
        `value` is the `Calibration`. `stats`: `rounds`, `steps`, `history`, `ignored`,
        maps on which no measure depends. Status `ok`; `budget_spent` where the last
        round still gained; `no_improvement` where nothing is better than the start;
        `infeasible` where limits cannot all be kept: `value` then breaks them least,
        and `detail` says by how much each would have to give; `start_diverged` where
        the cycle diverges with the calibration to begin with.

    Raises:
        SpecError: maps, measures or signals that make no sense.
        DataError: a signal of the cycle that has no number somewhere.

    Example:
        free = {"a": jnx.calibration.Calibratable(over=("time",), size=(4,))}
        wanted = [jnx.calibration.Measure("y ** 2")]
        found = jnx.calibration.optimise(network, data, free, wanted)
        print(found.value)
    """
    search = CalibrationSearch() if search is None else search
    if not maps:
        raise SpecError("a calibration needs at least one map", field="maps")
    if not objective:
        raise SpecError("a calibration needs an objective", field="objective")
    joined, draws, network = join_plants(plant, every)
    problem = make_problem(
        joined, draws, network, cycle, maps, objective, limits, search
    )
    before = run_cycle(problem, tuple(m.start for m in problem.maps))
    if not np.all(np.isfinite(np.asarray(before.y))):
        value = _value(problem, list(maps), cycle, network, before, None, None)
        text = "with the calibration to begin with the cycle diverges"
        return Solution(value, RESULTS.start_diverged, {}, text)
    problem = _with_levels(problem, before)
    free = begin_numbers(problem)[0]
    if begin is not None:
        free = _numbers_of(problem, list(maps), begin)
    run = _MapSearch(problem, search, free, folder, progress)
    return run.solve(list(maps), cycle, network, before)


def _numbers_of(
    problem: CalibrationProblem, names: list[str], begin: Calibration
) -> tuple[FreeNumbers, ...]:
    """The free numbers of an earlier calibration of the same maps."""
    there = {m.name: m for m in begin.maps}
    found = []
    for name, m in zip(names, problem.maps, strict=True):
        one = there.get(name)
        if one is None or one.value.shape != m.start.value.shape:
            raise SpecError(f"begin has no map of {name} as large", field="begin")
        low, high = np.asarray(m.low), np.asarray(m.high)
        share = np.clip((one.value - low) / (high - low), 0.0, 1.0)
        gaps = [np.log(np.diff(a)) for a in one.axes] if m.move_axes else []
        found.append(FreeNumbers(*jax.device_put((share, tuple(gaps)))))
    return tuple(found)


def _with_levels(problem: CalibrationProblem, before: CycleRun) -> CalibrationProblem:
    """The problem with the values of the start."""
    found = measure_run(problem, before)
    wanted, kept = (np.asarray(a).mean(axis=1) for a in found)
    level = np.where(np.abs(wanted) > 0, np.abs(wanted), 1.0)
    number = np.array(
        [
            one.number * (start if one.of_start else 1.0)
            for one, start in zip(problem.limits, kept, strict=True)
        ]
    ).reshape(len(kept))
    size = np.maximum(np.abs(number), SCALE_SHARE * np.abs(kept))
    index = None
    if problem.domain is not None:
        own = np.asarray(_indices(problem, before.u[:1]))[0]
        index = np.maximum(own, problem.search.index or np.inf)
    leaves = jax.device_put((level, number, np.where(size > 0, size, 1.0), index))
    level, number, size, index = leaves
    return dataclasses.replace(
        problem, level=level, limit=number, scale=size, index=index
    )


@program
def _indices(
    problem: CalibrationProblem, u: Float[Array, "draws records time inputs"]
) -> Float[Array, "draws records time"]:
    """Index of the domain at every sample."""
    return jax.vmap(jax.vmap(problem._index))(u)


@program
def _gradients(
    problem: CalibrationProblem, tables: tuple[LookupTable, ...]
) -> tuple[Float[Array, "..."], ...]:
    """How much every measure changes by every value of every map, mean of draws."""

    def measures(values):
        pairs = zip(tables, values, strict=True)
        moved = tuple(LookupTable(v, t.axes) for t, v in pairs)
        found = problem.measured(problem.run(moved), problem.search.sharp)
        return jnp.concatenate(found).mean(axis=1)

    return jax.jacrev(measures)(tuple(t.value for t in tables))


@program
def _visits(
    problem: CalibrationProblem, tables: tuple[LookupTable, ...], run: CycleRun
) -> tuple[Float[Array, "..."], ...]:
    """How many samples of the cycle every point of every map serves."""
    names, plant = problem.cycle.names, problem.plant

    def signal(name):
        if name in plant.outputs:
            y = run.y[0, ..., plant.outputs.index(name)]
            one = jnp.concatenate([y[:, :1], y[:, :-1]], axis=1)
        else:
            one = problem.cycle.values[..., names.index(name)]
        return one.reshape(-1)[problem.cycle.scored]

    return tuple(
        t.visits(*map(signal, m.over))
        for m, t in zip(problem.maps, tables, strict=True)
    )


class _MapSearch:
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
        self.start_merit = self.now = self.merit
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

    def solve(
        self, names: list[str], cycle: Dataset, network: Any, before: CycleRun
    ) -> Solution[Calibration]:
        """All rounds, and what has come of them."""
        self._resume()
        status = RESULTS.budget_spent
        while self.rounds < self.search.rounds:
            last = self.now
            self._round(1.0)
            gain = abs(last[1] - self.now[1])
            if not self.now[0] and gain < self.search.tolerance * (1 + abs(last[1])):
                status = RESULTS.ok
                break
        detail = ""
        multipliers = self.multipliers
        if self.merit[0] > 0:
            status = RESULTS.infeasible
            for _ in range(RELAXED_ROUNDS):
                self._round(0.0)
        elif not self.merit < self.start_merit:
            status, detail = RESULTS.no_improvement, "nothing is better than the start"
        tables = place_numbers(self.problem, self.best)
        if status is RESULTS.no_improvement:
            tables = tuple(m.start for m in self.problem.maps)
        value = _value(self.problem, names, cycle, network, before, tables, multipliers)
        ignored = [
            m.name
            for m in value.maps
            if max(np.abs(g).max() for g in m.gradient.values()) < TELLS_NOTHING
        ]
        stats: dict[str, Any] = {
            "rounds": self.rounds,
            "steps": self.steps,
            "history": self.history,
            "ignored": ignored,
        }
        detail = detail or _describe(value)
        if ignored:
            detail += f"; no measure depends on {list_names(ignored)}"
        return Solution(value, status, stats, detail)

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
        """What a state on disk belongs to."""
        leaves = [np.asarray(a).tobytes() for a in jax.tree.leaves(self.problem)]
        told = repr((self.problem.objective, self.problem.limits, self.search))
        return hashlib.sha256(b"".join(leaves) + told.encode()).hexdigest()

    def _keep(self) -> None:
        if self.path is None:
            return
        import io

        self.path.parent.mkdir(parents=True, exist_ok=True)
        held = io.BytesIO()
        arrays = {f"free{n}": a for n, a in enumerate(jax.tree.leaves(self.free))}
        arrays |= {f"best{n}": a for n, a in enumerate(jax.tree.leaves(self.best))}
        numbers = np.array([self.penalty, self.broken, *self.merit, *self.now])
        counts = np.array([self.rounds, self.steps])
        rest = {"multipliers": self.multipliers, "numbers": numbers, "counts": counts}
        key = np.frombuffer(self._key.encode(), np.uint8)
        table = {k: np.asarray(a) for k, a in (arrays | rest).items()}
        np.savez(held, key=key, **table)  # pyright: ignore[reportArgumentType]
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


def _value(
    problem: CalibrationProblem,
    names: list[str],
    data: Dataset,
    network: Any,
    before: CycleRun,
    tables: tuple[LookupTable, ...] | None,
    multipliers: np.ndarray | None,
) -> Calibration:
    """Everything that is to be told, from true measures."""
    begun = tuple(m.start for m in problem.maps)
    tables = begun if tables is None else tables
    after = run_cycle(problem, tables)
    start, found = measure_run(problem, before), measure_run(problem, after)
    gradients = _gradients(problem, tables)
    visits = _visits(problem, tables, after)
    objective = tuple(
        MeasureRow(str(m), float(a.mean()), float(b.mean()))
        for m, a, b in zip(
            problem.objective,
            np.asarray(start.objective),
            np.asarray(found.objective),
            strict=True,
        )
    )
    limits = _limit_rows(problem, start.limits, found.limits, multipliers)
    labels = [str(m) for m in problem.objective]
    labels += [str(one) for one in problem.limits]
    units = _units(data, network)
    maps = tuple(
        CalibratedMap(
            name,
            m.over,
            tuple(np.asarray(a) for a in t.axes),
            tuple(np.asarray(a) for a in m.start.axes),
            np.asarray(m.start.value),
            np.asarray(t.value),
            np.asarray(v),
            dict(zip(labels, map(np.asarray, np.asarray(g)), strict=True)),
            units.get(name, ""),
            tuple(units.get(s, "s" if s == TIME else "") for s in m.over),
        )
        for name, m, t, v, g in zip(
            names, problem.maps, tables, visits, gradients, strict=True
        )
    )
    lengths = [len(r) for r in data]

    def records(a):
        return tuple(np.asarray(a)[n, :length] for n, length in enumerate(lengths))

    index, start_index = (), ()
    if problem.domain is not None:
        index = records(_indices(problem, after.u[:1])[0])
        start_index = records(_indices(problem, before.u[:1])[0])
    plant = problem.plant
    channels = tuple(Channel(n, units.get(n, "")) for n in plant.outputs)
    return Calibration(
        maps,
        objective,
        limits,
        plant.inputs,
        channels,
        plant.sample_time,
        records(after.u[0]),
        records(after.y[0]),
        records(before.u[0]),
        records(before.y[0]),
        index,
        start_index,
    )


def _limit_rows(
    problem: CalibrationProblem, start: Any, found: Any, multipliers: Any
) -> tuple[MeasureRow, ...]:
    """Every limit with its margin; kept where the share of the draws that must keep it
    does, to within the tolerance."""
    start, found = np.asarray(start), np.asarray(found)
    excess = np.asarray(problem.excess(jnp.asarray(found))) if len(found) else []
    rows = []
    for n, one in enumerate(problem.limits):
        number, scale = float(problem.limit[n]), float(problem.scale[n])
        each = one.sign * (found[n] - number) / scale
        rows.append(
            MeasureRow(
                str(one),
                float(start[n].mean()),
                float(found[n].mean()),
                number,
                -float(excess[n]) * scale,
                0.0
                if multipliers is None
                else float(multipliers[n]) * abs(number) / scale,
                bool(excess[n] <= problem.search.tolerance),
                float(np.mean(each <= problem.search.tolerance)),
            )
        )
    return tuple(rows)


def _units(data: Dataset, network: Any) -> dict[str, str]:
    """Units by name, of the cycle's and the network's channels."""
    channels = [*data.channels.inputs, *data.channels.outputs]
    if network is not None:
        channels += [*network.channels.inputs, *network.output_channels]
    return {c.name: c.unit for c in channels}


def _describe(value: Calibration) -> str:
    """One sentence."""
    parts = []
    for row in value.objective:
        change = row.value / row.start - 1 if row.start else np.nan
        parts.append(f"{row.name} {100 * change:+.1f} %")
    broken = [r for r in value.limits if not r.kept]
    if broken:
        told = [f"{r.name} by {-(r.margin or 0.0):.3g}" for r in broken]
        parts.append(
            f"{len(broken)} of {len(value.limits)} limits cannot be kept together with "
            f"the others; at least they would have to give: {list_names(told)}"
        )
    elif value.limits:
        parts.append(f"all {len(value.limits)} limits kept")
    if value.index:
        out = np.mean([np.mean(i > 1) for i in value.index])
        parts.append(f"{100 * out:.1f} % of the samples outside of the domain")
    return "; ".join(parts)
