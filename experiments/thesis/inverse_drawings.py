"""Figures 7.9 to 7.14 for `chapter7_inverse.py`, from one seed."""

from pathlib import Path
from typing import Any

import numpy as np
from inverse_bed import STEP, TARGETS
from inverse_figures import Panel, authority, gain_signs, traces, unity
from inverse_models import turned
from inverse_seed import GUARD, LIMITS, TEST, Case
from inverse_spark import slope

import jaxnarx as jnx
from jaxnarx.evaluation.regions import describe_partition
from jaxnarx.shell.figures.draw import draw as draw_picture
from jaxnarx.shell.figures.partition import partition
from jaxnarx.shell.figures.style import save
from jaxnarx.shell.figures.tree import tree

SHOWN = 250
"""Samples drawn."""


def draw(case: Case, folder: Path, name: str, points: int) -> None:
    """All figures of a seed."""
    figures = {
        "data": channels(case),
        "fits": fits(case),
        "spark": spark(case),
        "tracking": tracking(case),
        "unity": gains(case, points),
    }
    found = describe_partition(
        case.direct, start=case.grown, data=turned(case.data[:GUARD])
    )
    if "THR" in found:
        entry = found["THR"]
        figures |= {
            "regions": draw_picture(partition(entry)),
            "tree": draw_picture(tree(entry)),
        }
    for what, figure in figures.items():
        save(figure, folder / f"{name}_{what}.png")


def span_of(case: Case) -> tuple[np.ndarray, slice]:
    """Times and samples that are drawn."""
    length = len(case.data.records[TEST])
    shown = slice(case.history, min(case.history + SHOWN, length - 10))
    return np.arange(shown.start, shown.stop) * STEP, shown


def channels(case: Case):
    """Figure 7.9: the data of the inverse."""
    time, shown = span_of(case)
    record = case.data.records[TEST]
    columns = np.concatenate([record.u, record.y], axis=1)
    named = zip(case.data.channels.all, columns.T, strict=True)
    panels = [Panel(c.label, {c.name: x[shown]}) for c, x in named if c.name != "LEAN"]
    return traces(time, panels, "unseen record of the bed (figure 7.9)")


def fits(case: Case):
    """Figures 7.12 and 7.13: spark and throttle of the inverse, free run."""
    time, shown = span_of(case)
    data = turned(case.data[TEST : TEST + 1])
    estimated = jnx.simulate(case.direct, data).value.outputs[0]
    panels = [
        Panel(c.label, {"recorded": y[shown], "inverse, free run": x[shown]})
        for c, y, x in zip(
            data.channels.outputs, data.records[0].y.T, estimated.T, strict=True
        )
    ]
    return traces(time, panels, "commands on unseen data (figures 7.12 and 7.13)")


def spark(case: Case):
    """Authority of the spark, and where it cannot be told."""
    s = case.spark
    late = s["true"] - s["best"]
    errors = {
        "inverse": s["estimated"] - s["true"],
        "bound: all but the spark known": s["mean"] - s["true"],
    }
    return authority(late, slope(late, s["full"]), errors)


def tracking(case: Case):
    """Figure 7.14: asked for and reached on the bed, open loop."""
    time, shown = span_of(case)
    asked = case.references.records[TEST].y
    runs = ("direct", "refined")
    panels = [
        Panel(
            case.data.channels.outputs[i].label,
            {"asked for": asked[shown, i]}
            | {name: case.tracks[name].outputs[shown, i] for name in runs},
        )
        for i in range(len(TARGETS))
    ]
    recorded = case.data.records[TEST].u
    for k, name in enumerate(("SA", "THR")):
        at = case.data.channels.signal(name)
        panels.append(
            Panel(
                case.data.channels.all[at].label,
                {"recorded": recorded[shown, at]}
                | {n: case.tracks[n].commands[shown, k] for n in runs},
            )
        )
    return traces(time, panels, "the bed behind the inverses, open loop (figure 7.14)")


def gains(case: Case, points: int):
    """Static gain and frequency response of the cascades on the model."""
    data = case.data[GUARD : GUARD + 1]
    found: dict[str, Any] = {
        name: jnx.inverse.unity_gain(
            net, case.forward, data, points=points, limits=LIMITS
        ).value
        for name, net in (("direct", case.direct), ("refined", case.refined))
    }
    return unity(found)


def draw_reversal(found: dict[str, Any], folder: Path, name: str) -> None:
    """Signs of the diesel's gain over EGR and VGT, by model and by bed."""
    gains = {"model": found["gain"], "bed": found["true"]}
    place = found["place"][:, [1, 2]]
    figure = gain_signs(place, gains, ("EGR [%]", "VGT [%]"), "VGT on W_c, ")
    save(figure, folder / f"{name}_diesel.png")
