"""Steady-state gains over the domain: inputs whose gain changes sign or jumps.

Physics seldom turns round: more fuel, more heat. At measured operating points spread
over the data every input is moved by 5 % (`INPUT_STEP_SHARE`) of its trained range to
either side and the model is run to rest. An input that moves an output up at some
points and down at others is told, and so is a small move of an input that moves an
output far: whether the engine does that is the user's to say.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.evaluation._steady_states import operating_point, steady_states
from jaxnarx.formatting import page
from jaxnarx.models import INPUT_STEP_SHARE, Network
from jaxnarx.simulation import match_records

MAX_REST_RUNS = 160
"""Runs to rest, of all points and inputs together."""
FEWEST_POINTS, MOST_POINTS = 4, 24
"""Operating points."""
LONGEST_REST_SAMPLES = 2048
"""Samples of the longest run to rest."""
FLAT_RANGE_SHARE = 0.05
"""Share of its trained range that an output has to move for the whole range of an
input; a smaller gain has no sign."""
RARE_POINT_SHARE = 0.02
"""Share of the points from which a sign is told, at least two points."""
JUMP_RANGE_SHARE, JUMP_MEDIAN_FACTOR = 0.2, 4.0
"""Share of its range that an output jumps by one step of an input, and how many times
that is the median of all points."""


@dataclasses.dataclass(frozen=True)
class GainFinding:
    """An input whose steady-state gain on an output changes sign, or jumps.

    `kind` is `"sign"` or `"jump"`, `share` that of the operating points with the rarer
    sign, or with a jump; `low` and `high` are the ends of the input there.
    """

    kind: str
    output: str
    over: str
    unit: str
    share: float
    low: float
    high: float
    rises: bool
    """Whether the output rises with the input at these points."""

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit not in ("", "-", "1") else ""
        ends = [f"{end:.4g}" for end in (self.low, self.high)]
        place = f"{self.over} {' to '.join(dict.fromkeys(ends))}{unit}"
        if self.kind == "jump":
            way = "rises" if self.rises else "falls"
            return (
                f"{self.output} at rest {way} suddenly with {self.over} in "
                f"{self.share:.0%} of the domain, at {place}; is that so?"
            )
        here, there = ("more", "less") if self.rises else ("less", "more")
        return (
            f"the gain of {self.output} by {self.over} changes sign: more {self.over}, "
            f"{here} {self.output} in {self.share:.0%} of the domain, at {place}, and "
            f"{there} elsewhere; is that so?"
        )

    _repr_html_ = page


@guard_arguments
def check_gains(network: Network, data: Dataset) -> tuple[GainFinding, ...]:
    """Inputs whose steady-state gain changes sign over the domain, or jumps.

    Points are measured samples of `data`, spread evenly; those at which the network
    does not come to rest, or that its domain does not know, say nothing.

    Example:
        for finding in jnx.evaluation.check_gains(network, data):
            print(finding)
    """
    moved = _moved_inputs(network)
    rows = _points(network, data, len(moved))
    if not moved or not len(rows):
        return ()
    low, high = (np.asarray(e, float) for e in (network.low, network.high))
    steps = np.zeros((len(moved), rows.shape[1]))
    steps[np.arange(len(moved)), moved] = INPUT_STEP_SHARE * (high - low)[moved]
    asked = np.stack([rows[None] - steps[:, None], rows[None] + steps[:, None]])
    inputs = slice(0, rows.shape[1])
    asked = np.clip(asked, low[inputs], high[inputs])
    every = np.concatenate([rows, asked.reshape(-1, rows.shape[1])])
    value = outputs_at_rest(network, data, every)
    shape = 2, len(moved), len(rows), value.shape[1]
    sides, middle = value[len(rows) :].reshape(shape), value[: len(rows)]
    own = np.array(network.signals)[: value.shape[1]]
    wide = np.where((high - low)[own] > 0, (high - low)[own], 1.0)
    cases = []
    for o, output in enumerate(network.output_channels):
        for k, s in enumerate(moved):
            x = np.stack([asked[0, k, :, s], rows[:, s], asked[1, k, :, s]])
            y = np.stack([sides[0, k, :, o], middle[:, o], sides[1, k, :, o]])
            channel = network.channels.inputs[s]
            name = output.name, channel.name, channel.unit
            scaled = (x - low[s]) / (high - low)[s], y / wide[o]
            cases += _sign(name, x[1], *scaled)
            cases += _jump(name, x[1], *scaled)
    return tuple(cases)


def outputs_at_rest(
    network: Network, data: Dataset, inputs: Float[np.ndarray, "points inputs"]
) -> Float[np.ndarray, "points outputs"]:
    """Outputs under held inputs; NaN where the network does not come to rest, or its
    domain does not know the inputs."""
    start = operating_point(network, data)[1]
    # Bands are not asked for.
    bare = dataclasses.replace(network, errors=None)
    found = steady_states(bare, inputs, start, longest=LONGEST_REST_SAMPLES)
    if found.index is None:
        return found.value
    return np.where((found.index <= 1)[:, None], found.value, np.nan)


def _moved_inputs(network: Network) -> list[int]:
    """Inputs that the network uses and that moved in training."""
    low, high = np.asarray(network.low), np.asarray(network.high)
    inputs = range(len(network.channels.inputs))
    return [s for s in network.used if s in inputs and high[s] > low[s]]


def _points(
    network: Network, data: Dataset, moved: int
) -> Float[np.ndarray, "points inputs"]:
    """Inputs of measured samples within the trained ranges, evenly spread."""
    inputs = len(network.channels.inputs)
    try:
        data = match_records(network, data)
    except SpecError:
        return np.zeros((0, inputs))
    rows = np.concatenate([r.signals[r.valid.all(axis=1)] for r in data])[:, :inputs]
    low, high = (np.asarray(e)[:inputs] for e in (network.low, network.high))
    rows = rows[np.all((rows >= low) & (rows <= high), axis=1)]
    count = int(np.clip(MAX_REST_RUNS // (1 + 2 * moved), FEWEST_POINTS, MOST_POINTS))
    at = (
        np.unique(np.linspace(0, len(rows) - 1, count).astype(int)) if len(rows) else []
    )
    return rows[np.asarray(at, int)].astype(float)


def _make_finding(
    kind: str,
    name: tuple[str, str, str],
    here: Float[np.ndarray, " points"],
    flag: Bool[np.ndarray, " points"],
    known: int,
    rises: bool,
) -> Iterator[GainFinding]:
    """A finding where enough of the known points are flagged."""
    count = int(flag.sum())
    if count >= max(2, RARE_POINT_SHARE * known):
        ends = float(here[flag].min()), float(here[flag].max())
        yield GainFinding(kind, *name, count / known, *ends, rises)


def _sign(
    name: tuple[str, str, str],
    here: Float[np.ndarray, " points"],
    x: Float[np.ndarray, "three points"],
    y: Float[np.ndarray, "three points"],
) -> Iterator[GainFinding]:
    """The rarer sign of the gain, of values in shares of their ranges."""
    with np.errstate(invalid="ignore"):
        gain = (y[2] - y[0]) / (x[2] - x[0])
        up, down = gain > FLAT_RANGE_SHARE, gain < -FLAT_RANGE_SHARE
    rises = bool(up.sum() < down.sum())
    known = int(up.sum() + down.sum())
    yield from _make_finding("sign", name, here, up if rises else down, known, rises)


def _jump(
    name: tuple[str, str, str],
    here: Float[np.ndarray, " points"],
    x: Float[np.ndarray, "three points"],
    y: Float[np.ndarray, "three points"],
) -> Iterator[GainFinding]:
    """Points at which one step moves the output far."""
    run = np.where(np.diff(x, axis=0) > 0, np.diff(x, axis=0), np.nan)
    step = INPUT_STEP_SHARE * np.diff(y, axis=0) / run
    known = np.asarray(np.isfinite(step).any(axis=0))
    if not known.any():
        return
    size = np.nanmax(np.abs(step[:, known]), axis=0)
    far = (size >= JUMP_RANGE_SHARE) & (size >= JUMP_MEDIAN_FACTOR * np.median(size))
    flag = np.zeros(len(known), bool)
    flag[known] = far
    if flag.any():
        rises = bool(np.nansum(step[:, flag]) > 0)
        yield from _make_finding("jump", name, here, flag, int(known.sum()), rises)
