"""Figures of a fleet: errors by samples, spread of the coefficients, its donors."""

import numpy as np

from jaxnarx.evaluation import Bars, Chart, Curve, Picture, StraightLine
from jaxnarx.fleet import FleetPrior
from jaxnarx.shell.figures.palette import shorten

MARKERS = {"as is": "", "offset and gain": "s", "prior": "o", "own fit": "^"}
COLOURS = {
    "as is": "grey",
    "offset and gain": "orange",
    "prior": "blue",
    "own fit": "green",
}
SHOWN_COEFFICIENTS = 16
COUNT_COLOURS = "blue", "orange", "green", "red"
MOST_SAMPLES = 100
"""Samples up to which errors are shown over the number of donors."""
SHRUNK_COEFFICIENTS, SHRUNK_DONORS, SHOWN_SPREADS = 8, 100, 4.0
"""Coefficients and donors of which shrinkage is shown, and deviations at most."""


def errors_by_samples(prior: FleetPrior, output: int) -> Picture:
    """NRMSE of donors that the others calibrate over the samples they are given."""
    table = prior.expected(output)
    marks = [
        Curve(kind, prior.rungs, errors, COLOURS[kind], marker=MARKERS[kind])
        for kind, errors in table.items()
    ]
    least, most = min(map(np.min, table.values())), float(np.max(table["as is"]))
    chart = Chart(
        tuple(marks),
        "samples of the new engine",
        f"free run of {prior.network.output_names[output]}, NRMSE",
        log="xy",
        y_range=(0.8 * float(least), max(1.0, 1.25 * most)),
        x_ticks=tuple((float(n), str(n)) for n in prior.rungs),
        legend="right",
    )
    return Picture((chart,), width=8.0, height=3.0)


def spread_of_coefficients(prior: FleetPrior) -> Picture:
    """Standard deviation of the coefficients that differ most."""
    spread = prior.spread
    order = np.argsort(-spread)[:SHOWN_COEFFICIENTS]
    names = [prior.names[n] for n in order.tolist()]
    places = np.arange(len(order))
    chart = Chart(
        (Bars(places, spread[order]),),
        "spread over engines, in deviations of the output",
        y_ticks=tuple(
            (float(n), shorten(name.split(": ", 1)[-1], 44))
            for n, name in zip(places, names, strict=True)
        ),
        y_range=(len(order) - 0.4, -0.6),
        x_range=(0.0, 1.05 * float(spread.max(initial=1e-9))),
    )
    return Picture((chart,), width=8.0, height=0.8 + 0.22 * len(order))


def errors_by_donors(prior: FleetPrior, output: int) -> Picture:
    """NRMSE of donors over the number of others that calibrate them."""
    table = prior.expected_by_donors(output)
    shown = [n for n in table if n <= MOST_SAMPLES] or list(table)[:1]
    marks = [
        Curve(f"{n} samples", prior.counts, table[n], colour, marker="o")
        for n, colour in zip(shown, COUNT_COLOURS, strict=False)
    ]
    chart = Chart(
        tuple(marks),
        "donors",
        f"free run of {prior.network.output_names[output]}, NRMSE",
        log="xy",
        x_ticks=tuple((float(n), str(n)) for n in prior.counts),
        legend="right",
    )
    return Picture((chart,), width=8.0, height=2.6)


def shrinkage(prior: FleetPrior) -> Picture:
    """Coefficients of donors by their own samples, and drawn to the others'."""
    spread = np.maximum(prior.spread, 1e-12)
    order = np.argsort(-spread)[:SHRUNK_COEFFICIENTS]
    place = np.arange(len(order), dtype=float)
    used = np.flatnonzero(prior.used)[:SHRUNK_DONORS]
    alone, drawn = (
        np.clip((v[used][:, order] / spread[order]).T, -SHOWN_SPREADS, SHOWN_SPREADS)
        for v in (prior.alone, prior.estimate)
    )
    style = {"line": "", "size": 3.5, "marker": "o"}
    kinds = (
        ("own samples alone", alone, -0.16, "orange"),
        ("with the fleet", drawn, 0.16, "blue"),
    )
    marks = [
        Curve(name, v.ravel(), np.repeat(place + up, len(used)), colour, **style)
        for name, v, up, colour in kinds
    ]
    chart = Chart(
        (StraightLine(0.0, "x", "grey", "dashed"), *marks),
        "deviations from the mean of the fleet, in its spreads",
        y_ticks=tuple(
            (float(n), shorten(prior.names[k].split(": ", 1)[-1], 44))
            for n, k in enumerate(order.tolist())
        ),
        y_range=(len(order) - 0.4, -0.6),
        x_range=(-SHOWN_SPREADS - 0.2, SHOWN_SPREADS + 0.2),
        legend="right",
    )
    return Picture((chart,), width=8.0, height=0.9 + 0.36 * len(order))


def distances(prior: FleetPrior) -> Picture:
    """How far donors lie from the others; those not used are crosses."""
    number = np.arange(1, len(prior.donors) + 1)
    used, far = prior.used, np.maximum(prior.distance, 1e-3)
    usual = float(np.sqrt(np.median(prior.freedom[used]))) if used.any() else 1.0
    style = {"line": "", "size": 4.5}
    chart = Chart(
        (
            StraightLine(usual, "y", "grey", "dashed", name="expected"),
            Curve("used", number[used], far[used], "blue", marker="o", **style),
            Curve("not used", number[~used], far[~used], "red", marker="x", **style),
        ),
        "donor",
        "distance from the others, deviations",
        log="y",
        whole="x",
        legend="right",
    )
    return Picture((chart,), width=8.0, height=2.6)
