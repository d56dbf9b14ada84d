"""Inputs of the data that judge beside those of the training, value by value."""

import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset
from jaxnarx.evaluation.charts import Chart, Curve
from jaxnarx.evaluation.section import FreeRun, Section
from jaxnarx.formatting import list_names

BINS = 40
"""Equal bins over the values of both."""
UNLIKE_OVERLAP = 0.7
"""Overlap of the densities below which an input is named and drawn."""
MOST_CHARTS = 3


def input_densities(run: FreeRun) -> Section | None:
    """How the values of every input are spread in training and in the data that judge.

    The overlap is the sum over bins of the smaller of both shares: one where both are
    spread alike, zero where no value is common. None without training data, or where
    they are what judges.
    """
    if run.training is None or run.training is run.data:
        return None
    rows, charts, unlike = [], [], []
    for s, channel in enumerate(run.data.channels.inputs):
        trained, judged = (_values(data, s) for data in (run.training, run.data))
        if not len(trained) or not len(judged):
            continue
        edges = _edges(trained, judged)
        shares = [np.histogram(v, edges)[0] / len(v) for v in (trained, judged)]
        overlap = float(np.minimum(*shares).sum())
        low, high = float(trained.min()), float(trained.max())
        outside = float(np.mean((judged < low) | (judged > high)))
        ends = float(judged.min()), float(judged.max())
        rows.append((channel.name, low, high, *ends, 100 * outside, overlap))
        if overlap < UNLIKE_OVERLAP:
            unlike.append((overlap, channel.name))
            charts.append((overlap, _chart(channel.label, edges, shares, run.part)))
    if not rows:
        return None
    charts.sort(key=lambda one: one[0])
    names = list_names([name for _, name in sorted(unlike)])
    told = f"All inputs are spread in {run.part} data as in training."
    if unlike:
        told = f"Values of {names} are spread differently in {run.part} data than in "
        told += "training."
    return Section(
        "Inputs beside the training",
        (told,),
        ("input", "trained min", "trained max", "min", "max", "outside %", "overlap"),
        tuple(rows),
        tuple(chart for _, chart in charts[:MOST_CHARTS]),
        "Overlap: share of the values that both have in common, over "
        f"{BINS} equal bins; 1 where both are spread alike.",
    )


def _values(data: Dataset, s: int) -> Float[np.ndarray, " samples"]:
    """Valid samples of an input over all records."""
    return np.concatenate([r.u[r.valid[:, s], s] for r in data]).astype(float)


def _edges(
    trained: Float[np.ndarray, " _"], judged: Float[np.ndarray, " _"]
) -> Float[np.ndarray, " edges"]:
    """Borders of the bins over both; one bin about what never moves."""
    low = min(trained.min(), judged.min())
    high = max(trained.max(), judged.max())
    if not high > low:
        return np.array([low - 0.5, low + 0.5])
    return np.linspace(low, high, BINS + 1)


def _chart(
    label: str,
    edges: Float[np.ndarray, " edges"],
    shares: list[Float[np.ndarray, " bins"]],
    part: str,
) -> Chart:
    """Shares of both by bin, as stairs."""
    x = np.repeat(edges, 2)[1:-1]
    curves = [
        Curve(name, x, 100 * np.repeat(share, 2))
        for name, share in zip(("training", part), shares, strict=True)
    ]
    return Chart(tuple(curves), label, "share of the samples [%]")
