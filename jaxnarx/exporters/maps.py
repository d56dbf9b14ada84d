"""Maps of a model at rest over one or two inputs, as calibrators know them."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.checks import require, require_known
from jaxnarx.exporters.form import Port, SampleProgram
from jaxnarx.exporters.interpret import LONGEST_SETTLING, Instance
from jaxnarx.models import Network

REST_NAME = "rest"
"""How maps are called: `NAME_rest_NOx`."""
AXIS_POINTS = 11
"""Points along each axis of a map."""
SEARCH_POINTS = 5
"""Points along every input where those that matter are looked for."""
FREE_AXIS = -1
"""An axis that is chosen when the maps are made."""


@dataclasses.dataclass(frozen=True, eq=False)
class RestMap:
    """A reported output where the free run has come to rest, over one or two inputs;
    the others are in the middle of their trained ranges. NaN where it does not rest."""

    output: Port
    axes: tuple[Port, ...]
    points: tuple[Float[np.ndarray, " _"], ...]
    values: Float[np.ndarray, "first *second"]


def choose_axes(
    network: Network, program: SampleProgram, over: Sequence[str] | None = None
) -> Int[np.ndarray, "reported two"]:
    """The inputs that every output's map goes over, by their places in the program.

    They are those named, or the first two that schedule the output; `FREE_AXIS` where
    it has fewer.
    """
    names = [port.name for port in program.inputs]
    count = len(program.reported)
    if over is not None:
        chosen = [names.index(require_known(name, names, "over")) for name in over]
        require(
            len(set(chosen)) == len(over) == min(2, len(names)),
            "over",
            f"over must name two inputs, got {', '.join(over) or 'none'}",
        )
        return np.tile([*chosen, FREE_AXIS][:2], (count, 1))
    channels = network.channels.names
    rows = []
    for model in network.models[:count]:
        known = network.tells(model.scheduling)
        signals = [channels[s] for s, _ in model.scheduling] if known else []
        found = list(dict.fromkeys(names.index(n) for n in signals if n in names))
        rows.append([*found, FREE_AXIS, FREE_AXIS][:2])
    return np.array(rows)


def rest_maps(
    program: SampleProgram, axes: Int[np.ndarray, "reported two"]
) -> list[RestMap]:
    """A map of every reported output. A free axis is the input that moves the output at
    rest most, of those that are not on the other; without any, a map has one axis, or
    there is none."""
    inputs = program.inputs
    low, high = (np.array([getattr(p, e) for p in inputs]) for e in ("low", "high"))
    moved = np.flatnonzero(high > low)
    chosen = _fill_inputs(program, axes, low, high, moved)
    grids = [_grid(low, high, one) for one in chosen]
    if not any(one for one in chosen):
        return []
    values, rested = _rest(program, np.concatenate(grids, axis=1))
    maps, at = [], 0
    for o, (one, grid) in enumerate(zip(chosen, grids, strict=True)):
        part = slice(at, at + grid.shape[1])
        at = part.stop
        if not one:
            continue
        found = np.where(rested[part], values[o, part], np.nan)
        points = [np.linspace(low[i], high[i], AXIS_POINTS) for i in one]
        ports = tuple(inputs[i] for i in one)
        shape = (AXIS_POINTS,) * len(one)
        port = program.reported[o]
        maps.append(RestMap(port, ports, tuple(points), found.reshape(shape)))
    return maps


def _grid(low, high, axes: Sequence[int]) -> Float[np.ndarray, "inputs points"]:
    """Inputs at all points of a map, the last axis first to change."""
    levels = [np.linspace(low[i], high[i], AXIS_POINTS) for i in axes]
    crossed = np.meshgrid(*levels, indexing="ij") if levels else []
    middle = 0.5 * (low + high)[:, None]
    grid = np.repeat(middle, crossed[0].size if crossed else 0, axis=1)
    for i, values in zip(axes, crossed, strict=True):
        grid[i] = values.ravel()
    return grid


def _fill_inputs(program: SampleProgram, axes, low, high, moved) -> list[list[int]]:
    """The inputs of every map, those that move most where an axis is free."""
    known = [[int(i) for i in row if i != FREE_AXIS and i in moved] for row in axes]
    if all(len(one) == min(2, len(moved)) for one in known):
        return known
    grid = np.repeat(0.5 * (low + high)[:, None], SEARCH_POINTS * len(moved), axis=1)
    for n, i in enumerate(moved):
        grid[i, n * SEARCH_POINTS : (n + 1) * SEARCH_POINTS] = np.linspace(
            low[i], high[i], SEARCH_POINTS
        )
    values, _ = _rest(program, grid)
    effect = np.ptp(values.reshape(len(values), len(moved), SEARCH_POINTS), axis=2)
    found = []
    for one, row in zip(known, effect, strict=True):
        order = [int(moved[n]) for n in np.argsort(-row, kind="stable")]
        found.append([*one, *(i for i in order if i not in one)][:2])
    return found


def _rest(program: SampleProgram, grid: Float[np.ndarray, "inputs points"]):
    """Reported outputs at rest, side by side, and where they are at rest."""
    instance = Instance(program)
    samples = instance.settle(grid)
    return instance.step(grid)["outputs"], samples < LONGEST_SETTLING
