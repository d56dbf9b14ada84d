"""A calibration as arrays: from free numbers to maps, runs, measures and limits.

Free numbers are the values of maps as shares of their ranges, from zero to one, and
where axes move the logarithms of the distances between their points, up to a factor.
All other conditions are inequalities g <= 0.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.arrays import program
from jaxnarx.calibration.measures import measure_value
from jaxnarx.calibration.plants import AbstractPlant
from jaxnarx.calibration.tables import LookupTable
from jaxnarx.models import Domain
from jaxnarx.settings import CalibrationSearch, CycleLimit, Measure

GAP_RATIO = 2.0
"""Logarithm of the factor by which points of an axis come closer or go apart."""
ALLOWED, EDGE = 0.01, 1e-3
"""Root mean square of the index beyond what it may be that counts as none, and what
rounds its root off."""
REST_ROUNDS = 5
"""Times that maps over outputs and a plant at rest are brought together."""
REMEMBERED = 256
"""Samples of a loop that are computed again for its derivative, not kept."""


class MovedMap(eqx.Module):
    """A map that sets one input of a plant, and what it may be; physical units."""

    column: int = eqx.field(static=True)
    over: tuple[str, ...] = eqx.field(static=True)
    start: LookupTable
    low: Float[Array, "*shape"]
    high: Float[Array, "*shape"]
    steps: tuple[float, ...] = eqx.field(static=True)
    slopes: tuple[int, ...] = eqx.field(static=True)
    move_axes: bool = eqx.field(static=True)

    def free(self) -> "FreeNumbers":
        """The free numbers of the start."""
        share = (self.start.value - self.low) / (self.high - self.low)
        gaps = tuple(jnp.log(jnp.diff(a)) for a in self.start.axes)
        return FreeNumbers(share, gaps if self.move_axes else ())

    def bounds(self) -> tuple["FreeNumbers", "FreeNumbers"]:
        """Least and largest free numbers."""
        start = self.free()
        low = FreeNumbers(
            jnp.zeros_like(start.value), tuple(g - GAP_RATIO for g in start.gaps)
        )
        high = FreeNumbers(
            jnp.ones_like(start.value), tuple(g + GAP_RATIO for g in start.gaps)
        )
        return low, high

    def place(self, free: "FreeNumbers") -> LookupTable:
        """The map of free numbers."""
        value = self.low + (self.high - self.low) * free.value
        axes = self.start.axes
        if self.move_axes:
            pairs = zip(axes, free.gaps, strict=True)
            axes = tuple(_between(a[0], a[-1], g) for a, g in pairs)
        return LookupTable(value, axes)

    def inequalities(self, table: LookupTable) -> Float[Array, " _"]:
        """Of steps and slopes; all hold where none is above zero."""
        rows = [jnp.zeros(0, table.value.dtype)]
        width = jnp.mean(self.high - self.low)
        for step, most, way in zip(table.steps(), self.steps, self.slopes, strict=True):
            if math.isfinite(most):
                rows.append((jnp.abs(step) / most - 1.0).ravel())
            if way:
                rows.append((-way * step / width).ravel())
        return jnp.concatenate(rows)


class FreeNumbers(eqx.Module):
    """The numbers of one map that a search moves."""

    value: Float[Array, "*shape"]
    gaps: tuple[Float[Array, " _"], ...]


def _between(first, last, gaps):
    share = jnp.cumsum(jax.nn.softmax(gaps))
    return jnp.concatenate(
        [first[None], first + (last - first) * share[:-1], last[None]]
    )


class DemandCycle(eqx.Module):
    """Signals over time, records side by side; `scored` are the samples that count,
    numbered record by record."""

    names: tuple[str, ...] = eqx.field(static=True)
    values: Float[Array, "records time names"]
    scored: Int[Array, " samples"]

    def signal(self, name: str) -> Float[Array, "records time"]:
        """One of them."""
        return self.values[..., self.names.index(name)]


class CycleRun(NamedTuple):
    """Inputs and outputs; of one draw where all have the same."""

    u: Float[Array, "draws records time inputs"]
    y: Float[Array, "draws records time outputs"]


class CalibrationProblem(eqx.Module):
    """Plant, cycle and maps, with what is wanted and what must be kept.

    `plant` has a leading axis of draws where there are several. `level` are the
    objective's values of the start, `limit` the numbers that every draw must keep,
    `scale` what a limit is measured by; `index` is the largest index of the domain at
    every sample.
    """

    plant: AbstractPlant
    draws: int = eqx.field(static=True)
    cycle: DemandCycle
    maps: tuple[MovedMap, ...]
    objective: tuple[Measure, ...] = eqx.field(static=True)
    limits: tuple[CycleLimit, ...] = eqx.field(static=True)
    search: CalibrationSearch = eqx.field(static=True)
    level: Float[Array, " objective"]
    limit: Float[Array, "limits draws"]
    scale: Float[Array, " limits"]
    domain: Domain | None = None
    index: Float[Array, "records time"] | None = None

    def free(self) -> tuple[FreeNumbers, ...]:
        """The free numbers of the start."""
        return tuple(m.free() for m in self.maps)

    def bounds(self) -> tuple[tuple[FreeNumbers, ...], tuple[FreeNumbers, ...]]:
        """Least and largest free numbers."""
        low, high = zip(*(m.bounds() for m in self.maps), strict=True)
        return low, high

    def place(self, free: tuple[FreeNumbers, ...]) -> tuple[LookupTable, ...]:
        """The maps of free numbers."""
        return tuple(m.place(f) for m, f in zip(self.maps, free, strict=True))

    def run(self, tables: tuple[LookupTable, ...]) -> CycleRun:
        """The cycle with these maps."""
        if any(s in self.plant.outputs for m in self.maps for s in m.over):

            def loop(plant, values):
                return self._run_loop(plant, values, tables)

            return CycleRun(*self._of_draws(loop, self.cycle.values))
        u = self.inputs(tables)
        return CycleRun(u[None], self._of_draws(lambda p, u: p.run(u), u))

    def _of_draws(self, function: Any, records: Float[Array, "records time _"]) -> Any:
        """A function of a plant and a record, of all of both."""
        many = jax.vmap(function, in_axes=(None, 0))
        if self.draws == 1:
            return jax.tree.map(lambda a: a[None], many(self.plant, records))
        return jax.vmap(many, in_axes=(0, None))(self.plant, records)

    def inputs(
        self, tables: tuple[LookupTable, ...]
    ) -> Float[Array, "records time inputs"]:
        """The plant's inputs with maps over signals of the cycle."""
        shape = self.cycle.values.shape[:2]
        found = dict(
            zip(self.cycle.names, jnp.moveaxis(self.cycle.values, -1, 0), strict=True)
        )
        signals = dict(found)
        for m, table in zip(self.maps, tables, strict=True):
            value = table(*(signals[s] for s in m.over))
            found[self.plant.inputs[m.column]] = jnp.broadcast_to(value, shape)
        return jnp.stack([found[n] for n in self.plant.inputs], axis=-1)

    def _run_loop(self, plant, values, tables):
        """One record with maps over outputs of the sample before."""
        names = self.cycle.names

        def inputs(row, y):
            def signal(name):
                if name in plant.outputs:
                    return y[plant.outputs.index(name)]
                return row[names.index(name)]

            found = {n: row[names.index(n)] for n in plant.inputs if n in names}
            for m, table in zip(self.maps, tables, strict=True):
                found[plant.inputs[m.column]] = table(*map(signal, m.over))
            return jnp.stack([found[n] for n in plant.inputs])

        y = self._middle(plant, tables, values.dtype)
        state, y = plant.begin(inputs(values[0], y))
        for _ in range(REST_ROUNDS):
            state, y = plant.begin(inputs(values[0], y))

        def step(carry, row):
            state, before = carry
            u = inputs(row, before)
            state, y = plant.step(state, u)
            return (state, y), (u, y)

        return scan_again(step, (state, y), values)

    def _middle(self, plant, tables, kind) -> Float[Array, " outputs"]:
        """Outputs in the middle of the maps over them."""
        y = jnp.zeros(len(plant.outputs), kind)
        for m, table in zip(self.maps, tables, strict=True):
            for s, axis in zip(m.over, table.axes, strict=True):
                if s in plant.outputs:
                    y = y.at[plant.outputs.index(s)].set((axis[0] + axis[-1]) / 2)
        return y

    def measured(self, run: CycleRun, sharp: float = 0.0) -> "CycleMeasures":
        """All measures of a run, by draw; with `sharp` smooth, see `measure_value`."""
        at = self.cycle.scored

        def flat(a, draws):
            return jnp.broadcast_to(a.reshape(draws, -1)[:, at], (draws, len(at)))

        def signal(name):
            if name in self.plant.outputs:
                one = run.y[..., self.plant.outputs.index(name)]
            elif name in self.plant.inputs:
                one = run.u[..., self.plant.inputs.index(name)]
            else:
                one = self.cycle.signal(name)[None]
            return flat(one, one.shape[0])

        def value(m):
            found = measure_value(m, signal, self.plant.sample_time, sharp)
            return jnp.broadcast_to(found, (self.draws,))

        def stacked(measures):
            rows = [value(m) for m in measures]
            empty = jnp.zeros((0, self.draws), run.y.dtype)
            return jnp.stack(rows) if rows else empty

        limits = stacked(tuple(one.measure for one in self.limits))
        return CycleMeasures(stacked(self.objective), limits)

    def excess(self, limits: Float[Array, "limits draws"]) -> Float[Array, " limits"]:
        """By how much limits are broken, over their scale: of the share of the draws
        that must keep them."""
        sign = jnp.array([one.sign for one in self.limits], limits.dtype)
        over = sign[:, None] * (limits - self.limit) / self.scale[:, None]
        if self.draws == 1:
            return over[:, 0]
        return jnp.quantile(over, self.search.draws, axis=1)

    def outside(
        self, u: Float[Array, "draws records time inputs"]
    ) -> Float[Array, " one"]:
        """Root mean square of the index beyond what it may be; empty without a
        domain."""
        if self.domain is None or self.index is None:
            return jnp.zeros(0, u.dtype)
        index = jax.vmap(jax.vmap(self.domain_index))(u)
        beyond = jnp.maximum(index - self.index[None], 0.0)
        beyond = beyond.reshape(u.shape[0], -1)[:, self.cycle.scored]
        # A root has no slope at zero, and a limit that nothing keeps strictly no end.
        return jnp.sqrt(jnp.mean(beyond**2) + EDGE**2)[None] - ALLOWED

    def domain_index(self, u: Float[Array, "time inputs"]) -> Float[Array, " time"]:
        """Index of the domain, one at its border."""
        assert self.domain is not None
        return self.domain.index(u, jnp.asarray(self.plant.sample_time, u.dtype))

    @property
    def conditions(self) -> int:
        """The number of inequalities."""
        count = len(self.limits) + (self.domain is not None and self.index is not None)
        for m in self.maps:
            for n, (most, way) in enumerate(zip(m.steps, m.slopes, strict=True)):
                shape = list(m.start.value.shape)
                shape[n] -= 1
                count += math.prod(shape) * (math.isfinite(most) + bool(way))
        return count

    def merit(self, free: tuple[FreeNumbers, ...]) -> "Merit":
        """Objective and inequalities of free numbers."""
        tables = self.place(free)
        run = self.run(tables)
        found = self.measured(run, self.search.sharp)
        weight = np.array([m.weight for m in self.objective])
        wanted = jnp.sum(weight * found.objective.mean(axis=1) / self.level)
        own = [m.inequalities(t) for m, t in zip(self.maps, tables, strict=True)]
        g = [self.excess(found.limits), *own, self.outside(run.u)]
        rough = sum(
            t.roughness(jnp.mean(m.high - m.low))
            for m, t in zip(self.maps, tables, strict=True)
        )
        return Merit(wanted + self.search.smooth * rough, jnp.concatenate(g))


class CycleMeasures(NamedTuple):
    """Measures of the objective and of the limits."""

    objective: Float[Array, "objective draws"]
    limits: Float[Array, "limits draws"]


class Merit(NamedTuple):
    """The objective, and the inequalities, which hold where none is above zero."""

    objective: Float[Array, ""]
    inequalities: Float[Array, " all"]


def scan_again(step: Any, carry: Any, rows: Float[Array, "time _"]) -> Any:
    """`lax.scan` whose derivative keeps one state in every so many samples."""
    count = rows.shape[0]
    blocks = -(-count // REMEMBERED)
    padded = jnp.pad(rows, ((0, blocks * REMEMBERED - count), (0, 0)), mode="edge")
    padded = padded.reshape(blocks, REMEMBERED, -1)

    @jax.checkpoint
    def block(carry, rows):
        return jax.lax.scan(step, carry, rows)

    found = jax.lax.scan(block, carry, padded)[1]
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:count], found)


@program
def begin_numbers(
    problem: CalibrationProblem,
) -> tuple[tuple[FreeNumbers, ...], tuple[FreeNumbers, ...], tuple[FreeNumbers, ...]]:
    """The free numbers of the start, the least and the largest."""
    return problem.free(), *problem.bounds()


@program
def place_numbers(
    problem: CalibrationProblem, free: tuple[FreeNumbers, ...]
) -> tuple[LookupTable, ...]:
    """The maps of free numbers."""
    return problem.place(free)


@program
def run_cycle(problem: CalibrationProblem, tables: tuple[LookupTable, ...]) -> CycleRun:
    """The cycle with these maps."""
    return problem.run(tables)


@program
def measure_run(problem: CalibrationProblem, run: CycleRun) -> CycleMeasures:
    """Measures without any smoothing."""
    return problem.measured(run)


@program
def domain_indices(
    problem: CalibrationProblem, u: Float[Array, "draws records time inputs"]
) -> Float[Array, "draws records time"]:
    """Index of the domain at every sample."""
    return jax.vmap(jax.vmap(problem.domain_index))(u)
