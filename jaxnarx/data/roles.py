"""Roles of the channels of files: input, output, time or none, by what is asked for,
their names, and how they move."""

import dataclasses
import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.data.families import NUMBER_MARK, plain_name
from jaxnarx.data.readers.columns import Column

SAME_CHANNEL_SHARE = 1e-9
"""Two channels are one where they differ by no more than this share of their spread."""
STEPPING_SHARE = 0.6
"""A channel that keeps its value from sample to sample this often moves in steps."""
SMALLEST_STEP_SHARE, SENSOR_LEVELS = 0.8, 6
"""Share of a coarse sensor's moves that are its smallest step, and its levels."""
NAMELESS_REASON = "it moves smoothly, and its name says nothing"
MAX_MISSING_SHARE = 0.5
"""A channel with more missing samples than this share is left out."""

_OUTPUT_NAMES = re.compile(
    r"no_?x|(?<![a-z])(co2?|[tu]?hc|pn|pm|o2|md|be)(?![a-z])|soot|smoke|fsn|opac|emiss"
    r"|afr|exh|abgas|egt|cat(?![a-z])|catalyst|turbine|torque|trq|power|imep|pmi|bsfc"
    r"|consum|knock|noise|vib|oil|cool|temp|^t_",
    re.I,
)
_INPUT_NAMES = re.compile(
    r"speed|rpm|n_?mot|(?<![a-z])(n|sa)(?![a-z])|drehzahl|load|last|throttle|thr|pedal"
    r"|inj|fue?l|fpw|ign|spark|zw|valve|vgt|wastegate|duty|cam|vvt|phi|rail|boost|set"
    r"|soll|cmd|demand|cut",
    re.I,
)
"""Usual names of channels of gasoline and diesel engines."""
_SAID_INPUT = re.compile(r"(?:^|[_. ])(?:[uU]|[iI]np?)(?![a-z])|(?i:input|eingang)")
_SAID_OUTPUT = re.compile(r"(?:^|[_. ])(?:[yYz]|[oO]ut)(?![a-z])|(?i:output|ausgang)")
"""Names in published data: `u`, `y1`, `uEst`, `InputGasRate`, `out`."""


@dataclasses.dataclass(frozen=True)
class ChannelGuess:
    """A channel that all files hold: its range, and what it is taken for and why.

    `role` is `"input"`, `"output"` or `"left out"`; `step` [s] its raster where it has
    one of its own; `missing` the share of samples that are not valid.
    """

    name: str
    unit: str
    low: float
    high: float
    missing: float
    role: str
    reason: str
    step: float | None = None

    @property
    def channel(self) -> str:
        """The name of the channel, where `name` is that of numbered columns."""
        return plain_name(self.name) if NUMBER_MARK in self.name else self.name


def look_at(
    column: Column, values: Sequence[Float[np.ndarray, " rows"]]
) -> ChannelGuess:
    """Range and share missing; constants and empty channels are left out."""
    x = np.concatenate(values)
    known = x[np.isfinite(x)]
    missing = 1 - len(known) / max(len(x), 1)
    low, high = (
        (float(known.min()), float(known.max())) if len(known) else (np.nan,) * 2
    )
    role, reason = "", ""
    if missing > MAX_MISSING_SHARE:
        role, reason = "left out", f"{missing:.0%} of the samples are missing"
    elif all(len(v) > 2 and counts_rows(v) for v in values):
        role, reason = "left out", "counts its rows"
    elif not high > low:
        role, reason = "left out", f"constant at {low:g}"
    return ChannelGuess(
        column.name, column.unit, low, high, missing, role, reason, column.step
    )


def find_twins(seen: Sequence[ChannelGuess], looked) -> dict[str, str]:
    """Channels that are the same as an earlier one, up to scale and offset."""
    alive = [one.name for one in seen if not one.role]
    if not alive:
        return {}
    rows = min(sum(len(values[n]) for values, _ in looked) for n in alive)
    known = np.stack(
        [np.concatenate([values[n] for values, _ in looked])[:rows] for n in alive]
    )
    good = np.isfinite(known).all(axis=0)
    if good.sum() < 10:
        return {}
    x = known[:, good]
    x = x - x.mean(axis=1, keepdims=True)
    size = np.sqrt((x**2).sum(axis=1, keepdims=True))
    x = x / np.where(size > 0, size, 1.0)
    alike = np.abs(x @ x.T) > 1 - SAME_CHANNEL_SHARE
    found = {}
    for i, name in enumerate(alive):
        earlier = [alive[j] for j in range(i) if alike[i, j] and alive[j] not in found]
        if earlier:
            found[name] = earlier[0]
    return found


def assign_roles(
    seen: Sequence[ChannelGuess],
    twins: Mapping[str, str],
    looked: Sequence[tuple[Mapping[str, Float[np.ndarray, " rows"]], Mapping]],
    outputs: Sequence[str],
    inputs: Sequence[str],
) -> list[ChannelGuess]:
    """Every channel with its role and the reason for it.

    With `outputs` all others are inputs, with `inputs` too they are left out.
    """

    def role(one: ChannelGuess) -> tuple[str, str]:
        if one.name in outputs or one.name in inputs:
            return ("output" if one.name in outputs else "input"), "as asked for"
        if one.role:
            return one.role, one.reason
        if one.name in twins and twins[one.name] not in (*outputs, *inputs):
            return "left out", f"the same as {twins[one.name]}, up to scale"
        if one.name in twins:
            return "left out", f"the same as {twins[one.name]}"
        by_name = _role_by_name(one.name)
        if inputs and not outputs and by_name == "output":
            return by_name, "by its name"
        if inputs:
            return "left out", "not asked for"
        if outputs:
            named = "by its name" if by_name == "input" else "not asked for as output"
            return "input", named
        if by_name:
            return by_name, "by its name"
        still = _share_still([values[one.name] for values, _ in looked])
        if still > STEPPING_SHARE:
            return "input", f"moves in steps ({still:.0%} of the samples keep still)"
        return "output", NAMELESS_REASON

    told = [
        dataclasses.replace(one, role=found[0], reason=found[1])
        for one in seen
        for found in [role(one)]
    ]
    return told if outputs or inputs else _both(told)


def _role_by_name(name: str) -> str:
    """`"input"`, `"output"`, or nothing."""
    if _SAID_INPUT.search(name):
        return "input"
    if _SAID_OUTPUT.search(name) or _OUTPUT_NAMES.search(name):
        return "output"
    return "input" if _INPUT_NAMES.search(name) else ""


def _both(guessed: list[ChannelGuess]) -> list[ChannelGuess]:
    """At least one input and one output, where channels are left whose names say
    nothing: files begin with inputs and end with outputs."""
    roles = {one.role for one in guessed}
    open_ = [n for n, one in enumerate(guessed) if _is_open(one)]
    if not open_ or {"input", "output"} <= roles:
        return guessed
    if "output" not in roles:
        chosen = {open_[-1]: ("output", "the last channel that no name calls an input")}
    elif any(one.role == "output" and not _is_open(one) for one in guessed):
        chosen = dict.fromkeys(open_, ("input", "no name calls it an output"))
    else:
        chosen = {open_[0]: ("input", "the first channel; no name says what it is")}
    return [
        one
        if n not in chosen or len(guessed) < 2
        else dataclasses.replace(one, role=chosen[n][0], reason=chosen[n][1])
        for n, one in enumerate(guessed)
    ]


def _is_open(one: ChannelGuess) -> bool:
    """Whether a channel's name says nothing."""
    return one.role in ("input", "output") and one.reason != "by its name"


def _share_still(values: Sequence[Float[np.ndarray, " rows"]]) -> float:
    """Share of the samples that keep the value before; none of a coarse sensor, which
    moves by its smallest step, but between many levels."""
    x = np.concatenate(values)
    moves = np.abs(np.diff(x[np.isfinite(x)]))
    jumps = moves[moves > 0]
    if not jumps.size:
        return 1.0
    single = np.mean(jumps < 1.5 * jumps.min())
    if (
        single > SMALLEST_STEP_SHARE
        and len(np.unique(np.round(x / jumps.min()))) >= SENSOR_LEVELS
    ):
        return 0.0
    return float(np.mean(moves == 0))


def counts_rows(t: Float[np.ndarray, " rows"]) -> bool:
    """Whether stamps are the numbers of their rows."""
    return len(t) > 1 and bool(np.all(np.diff(t) == 1))
