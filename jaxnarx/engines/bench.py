"""Checks of what goes into a virtual engine and of what comes out, on the host."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float

from jaxnarx.checks import not_negative, require_known
from jaxnarx.errors import DataError, SpecError

# `engine` is an `AbstractEngine` throughout; not named, to keep imports one-way.


class Noise(NamedTuple):
    """White measurement noise of standard deviation absolute + relative |reading|.

    `absolute` in the unit of the output, `relative` dimensionless.
    """

    absolute: float = 0.0
    relative: float = 0.0


def check_record(engine: Any, inputs: ArrayLike) -> Float[np.ndarray, "time inputs"]:
    """One record's inputs as a finite matrix with the columns of `engine`.

    Raises `SpecError` where the shape is not that, or a value is not finite.
    """
    expected = engine.channels.input_names
    u = np.asarray(inputs, float)
    u = u[:, None] if u.ndim == 1 and len(expected) == 1 else u
    if u.ndim != 2 or u.shape[1] != len(expected) or u.shape[0] == 0:
        raise SpecError(
            f"inputs must have shape (time, {len(expected)}) with columns "
            f"{', '.join(expected)}; got {u.shape}",
            field="inputs",
        )
    if not np.isfinite(u).all():
        event = int(np.argmin(np.isfinite(u).all(axis=1)))
        column = int(np.argmin(np.isfinite(u[event])))
        raise SpecError(
            f"inputs must be finite; {expected[column]} is {u[event, column]} at event "
            f"{event}",
            field="inputs",
        )
    return u


def choose_outputs(engine: Any, outputs: Sequence[str] | None) -> list[int]:
    """Columns of the chosen outputs; all for `None`. `SpecError` for an unknown one."""
    known = engine.channels.output_names
    chosen = known if outputs is None else list(outputs)
    for name in chosen:
        require_known(
            name,
            known,
            "outputs",
            f"outputs must be among {', '.join(known)}; got {name!r}",
        )
    if not chosen:
        raise SpecError(f"outputs must name some of {', '.join(known)}; got none")
    return [known.index(name) for name in chosen]


def require(
    rows: list[Float[np.ndarray, "_ inputs"]], names: list[str], noise: float | int
) -> None:
    """Raise `SpecError` where there is no record, not one name each, or bad noise."""
    if not rows or len(names) != len(rows):
        raise SpecError(
            f"got {len(rows)} record(s) and {len(names)} name(s); give at least one "
            "record and one name for each",
            field="names",
        )
    not_negative(noise, "noise")


def refuse_outside(
    engine: Any, u: Float[np.ndarray, "time inputs"], record: str
) -> None:
    """Raise `DataError` at the first input outside the domain of `engine`.

    A billionth of the range is allowed for rounding.
    """
    channels = engine.channels.inputs
    low, high = np.asarray([engine.domain[c.name] for c in channels], float).T
    slack = 1e-9 * (high - low)
    outside = (u < low - slack) | (u > high + slack)
    if not outside.any():
        return
    event = int(np.argmax(outside.any(axis=1)))
    j = int(np.argmax(outside[event]))
    raise DataError(
        f"record {record!r}: input {_reading(channels[j], u[event, j])} at event "
        f"{event}, outside {low[j]:g} to {high[j]:g} where the model holds; keep it "
        "inside",
        channel=channels[j].name,
        row=event,
    )


def refuse_faults(
    engine: Any,
    u: Float[np.ndarray, "time inputs"],
    y: Float[np.ndarray, "time outputs"],
    record: str,
) -> None:
    """Raise `DataError` at the first output that ends a run: outside `engine.limits`,
    or not finite."""
    within = np.isfinite(y)
    for j, name in enumerate(engine.channels.output_names):
        low, high = engine.limits.get(name, (-np.inf, np.inf))
        within[:, j] &= (y[:, j] >= low) & (y[:, j] <= high)
    if within.all():
        return
    event = int(np.argmin(within.all(axis=1)))
    column = int(np.argmin(within[event]))
    channel = engine.channels.outputs[column]
    bounds = engine.limits.get(channel.name)
    inputs = zip(engine.channels.inputs, u[event], strict=True)
    raise DataError(
        f"record {record!r}: {_reading(channel, y[event, column])} at event {event}"
        + (f", outside {bounds[0]:g} to {bounds[1]:g}" if bounds else "")
        + f", where {', '.join(_reading(c, value) for c, value in inputs)}; the engine "
        "stalls or has no steady state there: use a smaller input range or longer hold "
        "times",
        channel=channel.name,
        row=event,
    )


def pad_records(
    rows: list[Float[np.ndarray, "_ inputs"]],
) -> Float[np.ndarray, "records time inputs"]:
    """One array of all records, each held at its last row up to the longest."""
    length = max(map(len, rows))
    return np.stack(
        [np.pad(u, ((0, length - len(u)), (0, 0)), mode="edge") for u in rows]
    )


def number_records(count: int) -> list[str]:
    """Names for records that have none."""
    return [f"record {i + 1}" for i in range(count)]


def _reading(channel: Any, value: float) -> str:
    unit = "" if channel.unit in ("-", "") else f" {channel.unit}"
    return f"{channel.name} is {value:.6g}{unit}"
