"""Figures of a calibration: maps before and after, what the cycle becomes."""

import numpy as np
from jaxtyping import Float

from jaxnarx.calibration import CalibratedMap, Calibration
from jaxnarx.evaluation import Cells, Chart, Curve, Picture

UNSEEN = 1e-9
"""Visits of a point that count as none."""
SHOWN_SAMPLES = 3_000
"""Samples of a record that are shown; longer ones are cut."""


def map_picture(one: CalibratedMap) -> Picture:
    """A map before, after, and what has changed; points that the cycle never visits are
    crossed."""
    if len(one.axes) < 2:
        return _curve(one)
    crossed = one.visits < UNSEEN
    labels = [_with_unit(*pair) for pair in zip(one.over, one.axis_units, strict=True)]
    parts = (
        ("before", one.start, one.start_axes, False),
        ("after", one.value, one.axes, False),
        ("change", one.value - one.start, one.axes, True),
    )
    charts = [
        Chart(
            (
                Cells(
                    _edges(axes[0]),
                    _edges(axes[1]),
                    value,
                    signed=signed,
                    crossed=crossed,
                ),
            ),
            labels[0],
            labels[1],
            _with_unit(f"{one.name}, {name}", one.unit),
        )
        for name, value, axes, signed in parts
    ]
    return Picture(tuple(charts), columns=3, width=11.0, height=3.0)


def _curve(one: CalibratedMap) -> Picture:
    (axis,), (before,) = one.axes, one.start_axes
    chart = Chart(
        (
            Curve("before", before, one.start, "grey", line="dashed", marker="o"),
            Curve("after", axis, one.value, "blue", marker="o"),
        ),
        _with_unit(one.over[0], one.axis_units[0]),
        _with_unit(one.name, one.unit),
    )
    return Picture((chart,), width=8.0, height=2.6)


def trajectories(value: Calibration, record: int = 0) -> Picture:
    """Inputs that maps set, outputs and index over the cycle, before and after."""
    moved = {m.name for m in value.maps}
    rows = [
        (name, value.start_inputs[record][:, n], value.inputs[record][:, n])
        for n, name in enumerate(value.input_names)
        if name in moved
    ]
    rows += [
        (
            _with_unit(c.name, c.unit),
            value.start_outputs[record][:, n],
            value.outputs[record][:, n],
        )
        for n, c in enumerate(value.output_channels)
    ]
    if value.index:
        rows.append(("index", value.start_index[record], value.index[record]))
    count = min(SHOWN_SAMPLES, len(value.inputs[record]))
    time = np.arange(count) * value.sample_time
    charts = [
        Chart(
            (
                Curve("before", time, before[:count], "grey"),
                Curve("after", time, after[:count], "blue"),
            ),
            "time [s]" if n == len(rows) - 1 else "",
            name,
            legend="above" if n == 0 else "",
        )
        for n, (name, before, after) in enumerate(rows)
    ]
    return Picture(tuple(charts), width=11.0, height=1.6 * len(rows), shared="x")


def _edges(points: Float[np.ndarray, " points"]) -> Float[np.ndarray, " edges"]:
    middle = (points[1:] + points[:-1]) / 2
    first, last = 2 * points[0] - middle[0], 2 * points[-1] - middle[-1]
    return np.concatenate([[first], middle, [last]])


def _with_unit(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
