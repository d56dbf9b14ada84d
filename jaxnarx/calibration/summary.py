"""A calibration with all that is told of it, from true measures."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.arrays import program
from jaxnarx.calibration.problem import (
    CalibrationProblem,
    CycleRun,
    domain_indices,
    measure_run,
    run_cycle,
)
from jaxnarx.calibration.result import CalibratedMap, Calibration, MeasureRow
from jaxnarx.calibration.tables import LookupTable
from jaxnarx.data import Channel, Dataset
from jaxnarx.formatting import list_names
from jaxnarx.models import Network
from jaxnarx.settings import TIME

TELLS_NOTHING = 1e-12
"""Largest change of any measure by a map on which nothing depends."""


def summarise(
    problem: CalibrationProblem,
    names: list[str],
    data: Dataset,
    network: Network | None,
    before: CycleRun,
    tables: tuple[LookupTable, ...],
    multipliers: Float[np.ndarray, " all"],
) -> Calibration:
    """The calibration with these maps, beside the run `before` of those of the start;
    `multipliers` are those of the search, limits first."""
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
        index = records(domain_indices(problem, after.u[:1])[0])
        start_index = records(domain_indices(problem, before.u[:1])[0])
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
    problem: CalibrationProblem,
    start: Float[Array, "limits draws"],
    found: Float[Array, "limits draws"],
    multipliers: Float[np.ndarray, " all"],
) -> tuple[MeasureRow, ...]:
    """Every limit with its margin; kept where the share of the draws that must keep it
    does, to within the tolerance."""
    excess = np.asarray(problem.excess(found)) if len(found) else []
    before, after = np.asarray(start), np.asarray(found)
    rows = []
    for n, one in enumerate(problem.limits):
        limit, scale = np.asarray(problem.limit[n]), float(problem.scale[n])
        number = float(limit.mean())
        each = one.sign * (after[n] - limit) / scale
        rows.append(
            MeasureRow(
                str(one),
                float(before[n].mean()),
                float(after[n].mean()),
                number,
                -float(excess[n]) * scale,
                float(multipliers[n]) * abs(number) / scale,
                bool(excess[n] <= problem.search.tolerance),
                float(np.mean(each <= problem.search.tolerance)),
            )
        )
    return tuple(rows)


def _units(data: Dataset, network: Network | None) -> dict[str, str]:
    """Units by name, of the cycle's and the network's channels."""
    channels = [*data.channels.inputs, *data.channels.outputs]
    if network is not None:
        channels += [*network.channels.inputs, *network.output_channels]
    return {c.name: c.unit for c in channels}


def ignored_maps(value: Calibration) -> list[str]:
    """Names of maps on which no measure depends."""
    return [
        m.name
        for m in value.maps
        if max(np.abs(g).max() for g in m.gradient.values()) < TELLS_NOTHING
    ]


def describe(value: Calibration, worst: float) -> str:
    """One sentence; `worst` is the largest share by which any inequality is broken
    beyond what is allowed."""
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
    if worst > 0 and not broken:
        parts.append(
            "steps or slopes of maps, the domain or smooth peaks cannot be kept, by "
            f"{100 * worst:.2g} %"
        )
    if value.index:
        out = np.mean([np.mean(i > 1) for i in value.index])
        parts.append(f"{100 * out:.1f} % of the samples outside of the domain")
    if ignored := ignored_maps(value):
        parts.append(f"no measure depends on {list_names(ignored)}")
    return "; ".join(parts)


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
