"""The error of a model that learns, window by window."""

import numpy as np

from jaxnarx.evaluation import Chart, Curve, Picture
from jaxnarx.models import Network
from jaxnarx.solution import Solution


def adaptation_picture(found: Solution[Network]) -> Picture:
    """Every output's error by window, beside that of the model as it began and their
    difference; windows that were undone are marked."""
    stats, channels = found.stats, found.value.output_channels
    window = stats["window"] * float(found.value.sample_time)
    time = window * (1.0 + np.arange(len(stats["undone"])))
    charts = []
    for o, channel in enumerate(channels):
        now, at = stats["rmse"][:, o], stats["undone"][:, o]
        curves = [
            Curve("as it began", time, stats["rmse_start"][:, o], "grey"),
            Curve("adapted", time, now, "blue"),
            Curve("difference", time, stats["drift"][:, o], "orange", "dashed"),
        ]
        if at.any():
            curves.append(Curve("undone", time[at], now[at], "red", "", marker="x"))
        last = o == len(channels) - 1
        charts.append(
            Chart(
                tuple(curves),
                "end of the window [s]" if last else "",
                f"{channel.name} [{channel.unit}]" if channel.unit else channel.name,
                legend="above" if o == 0 or at.any() else "",
            )
        )
    return Picture(tuple(charts), width=9.0, height=1.8 * len(charts), shared="x")
