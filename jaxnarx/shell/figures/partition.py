"""Where the local models are valid, before and after refinement.

One scheduling variable: validity over its range. Two: a map of the regions. More: every
model's extent in each variable, or the tree. Weights come from the network itself, see
`jaxnarx.evaluation.describe_partition`; nothing here knows a validity function.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import contourpy
import numpy as np
from scipy.ndimage import distance_transform_edt

from jaxnarx.evaluation import (
    Chart,
    Curve,
    Mark,
    Picture,
    Range,
    RegionMap,
    Text,
    ellipse,
)
from jaxnarx.shell.figures.palette import shorten
from jaxnarx.shell.figures.tree import tree

MAX_DATA_POINTS = 1500
"""Data points drawn."""
BORDER_POINTS = 81
"""Points along each side of the grid on which borders are found."""
RUG_POINTS = 300
"""Data points drawn below the curves of one variable."""

Side = Mapping[str, Any]
"""`regions`, and where known `weights`, of one partition."""


def partition(entry: Mapping[str, Any]) -> Picture:
    """The partition of one output, an entry of `describe_partition`.

    Before and after stand side by side where both are there. Widths and centres outside
    the range are drawn where they fall in it; at most 1500 points of the cloud are
    drawn.
    """
    names = list(entry["scheduling"])
    box = np.asarray(entry["ranges"], float).reshape(len(names), 2)
    sides = _title_sides(entry)
    points = _thin(entry.get("cloud"))
    drawable = all("weights" in side for _, side in sides)
    if not drawable and "gates" in entry["after"]:
        return tree(entry)
    if drawable and len(names) == 1:
        return _curves(names[0], box[0], sides, points)
    if drawable:
        return _maps(names, box, sides, points)
    return _spans(names, box, sides)


def _title_sides(entry: Mapping[str, Any]) -> list[tuple[str, Side]]:
    """Both sides by name; one alone needs none."""
    if "before" not in entry:
        return [("", entry["after"])]
    return [
        ("before refinement", entry["before"]),
        ("after refinement", entry["after"]),
    ]


def _thin(cloud: np.ndarray | None) -> np.ndarray | None:
    if cloud is None or len(cloud) == 0:
        return None
    cloud = np.asarray(cloud, float).reshape(len(cloud), -1)
    return cloud[np.unique(np.linspace(0, len(cloud) - 1, MAX_DATA_POINTS).astype(int))]


def _curves(name: str, box: np.ndarray, sides, points) -> Picture:
    charts = []
    for title, side in sides:
        weights = np.asarray(side["weights"], float)
        z = np.linspace(box[0], box[1], weights.shape[1])
        marks: list[Mark] = []
        for m, weight in enumerate(weights):
            leads = weight >= weights.max(axis=0)
            marks.append(Curve("", z, weight, m))
            marks.append(_name_curve(m, z, weight, leads))
        if points is not None:
            rug: dict[str, Any] = {"line": "", "marker": "|", "size": 5, "opacity": 0.4}
            at = points[:RUG_POINTS, 0]
            marks.append(Curve("", at, np.full(len(at), -0.06), "ink", **rug))
        ends = _ends(box)
        charts.append(
            Chart(
                *(tuple(marks), name, "validity", title),
                x_range=ends,
                y_range=(-0.12, 1.18),
            )
        )
    return Picture(tuple(charts), len(charts), height=2.6, shared="y")


def _name_curve(m: int, z, weight, leads) -> Text:
    """The number above the middle of where a model leads, or else at its peak."""
    at = float(z[leads].mean()) if leads.any() else float(z[weight.argmax()])
    height = 1.03 if leads.any() else float(weight.max())
    return Text(at, height, str(m + 1), m, up="bottom", bold=True)


def _ends(box: np.ndarray) -> Range:
    return float(box[0]), float(box[1])


def _maps(names: list[str], box: np.ndarray, sides, points) -> Picture:
    charts = []
    for title, side in sides:
        weights = np.asarray(side["weights"], float)
        lead = weights.argmax(axis=0)
        marks: list[Mark] = [
            RegionMap(_ends(box[0]), _ends(box[1]), lead, weights.max(axis=0))
        ]
        if points is not None:
            dots: dict[str, Any] = {"line": "", "marker": ".", "size": 2.2}
            marks.append(
                Curve("", points[:, 0], points[:, 1], "grey", opacity=0.6, **dots)
            )
        marks += _borders(weights, lead, box)
        for m, region in enumerate(side["regions"]):
            marks += _centre(m, box, region)
            if not _has_centre_in(box, region):
                marks += _number(m, lead, box)
        ends: dict[str, Any] = {"x_range": _ends(box[0]), "y_range": _ends(box[1])}
        charts.append(Chart(tuple(marks), names[0], names[1], title, **ends))
    return Picture(tuple(charts), len(charts), height=4.0, shared="xy")


def _grid(box: np.ndarray, shape: tuple[int, ...]) -> list[np.ndarray]:
    return [np.linspace(a, b, n) for (a, b), n in zip(box, shape, strict=True)]


def _borders(weights: np.ndarray, lead: np.ndarray, box: np.ndarray) -> Iterator[Curve]:
    """Lines where two models are equal."""
    step = [max(1, (n - 1) // (BORDER_POINTS - 1)) for n in lead.shape]
    x, y = (g[::k] for g, k in zip(_grid(box, lead.shape), step, strict=True))
    weights, lead = weights[:, :: step[0], :: step[1]], lead[:: step[0], :: step[1]]
    for m in range(len(weights)):
        own = lead == m
        if not own.any() or own.all():
            continue
        ahead = weights[m] - np.delete(weights, m, axis=0).max(axis=0)
        for line in contourpy.contour_generator(x, y, ahead.T).lines(0.0):
            x_y = np.asarray(line)
            yield Curve("", x_y[:, 0], x_y[:, 1], "ink", width=0.7)


def _number(m: int, lead: np.ndarray, box: np.ndarray) -> Iterator[Text]:
    """The number of a model where its border is farthest."""
    own = lead == m
    if own.any():
        inside = np.asarray(distance_transform_edt(np.pad(own, 1)))[1:-1, 1:-1]
        place = np.unravel_index(inside.argmax(), inside.shape)
        x, y = (g[i] for g, i in zip(_grid(box, lead.shape), place, strict=True))
        yield Text(float(x), float(y), str(m + 1), bold=True)


def _extents(
    region: Mapping[str, Mapping[str, float]],
) -> tuple[np.ndarray, ...] | None:
    """Centre and width of a model that has them in both variables."""
    extents = list(region.values())
    if len(extents) != 2 or not all("centre" in e for e in extents):
        return None
    return tuple(np.array([e[k] for e in extents]) for k in ("centre", "width"))


def _has_centre_in(box: np.ndarray, region: Mapping[str, Mapping[str, float]]) -> bool:
    found = _extents(region)
    return found is not None and bool(
        np.all((found[0] >= box[:, 0]) & (found[0] <= box[:, 1]))
    )


def _centre(
    m: int, box: np.ndarray, region: Mapping[str, Mapping[str, float]]
) -> Iterator[Mark]:
    """Dot, ring and number of a model that has a centre and widths; its number shows
    only where the centre does."""
    found = _extents(region)
    if found is None:
        return
    (x, y), (wide, high) = (f.tolist() for f in found)
    yield Curve("", *ellipse((x, y), (wide, high)), m, width=1.0, opacity=0.8)
    yield Curve("", [x], [y], m, line="", marker="o", size=4.5)
    if _has_centre_in(box, region):
        number = str(m + 1)
        yield Text(x, y, number, across="left", up="bottom", bold=True, nudge=(4, 3))


def _spans(scheduling: Sequence[str], box: np.ndarray, sides) -> Picture:
    """Every model's extent in each variable, one chart per variable."""
    models = max(len(side["regions"]) for _, side in sides)
    colours = ("grey", "blue") if len(sides) == 2 else ("blue",)
    panels: list[list[Mark]] = [[] for _ in scheduling]
    for s, (title, side) in enumerate(sides):
        offset = 0.24 * (s - 0.5 * (len(sides) - 1))
        for m, region in enumerate(side["regions"]):
            at = m + 1 + offset
            for n, (marks, name, limits) in enumerate(
                zip(panels, scheduling, box, strict=True)
            ):
                low, centre, high = _extent(region.get(name, {}), limits)
                text = title if m == 0 and n == 0 else ""
                ends = [low, high], [at, at]
                marks.append(Curve(text, *ends, colours[s], width=1.8))
                if centre is not None:
                    dot: dict[str, Any] = {"line": "", "marker": "o", "size": 4}
                    marks.append(Curve("", [centre], [at], colours[s], **dot))
    ticks = tuple((float(m + 1), str(m + 1)) for m in range(models))
    charts = [
        Chart(
            *(tuple(marks), shorten(name), "local model"),
            x_range=_ends(limits),
            y_range=(models + 0.6, 0.4),
            y_ticks=ticks,
        )
        for marks, name, limits in zip(panels, scheduling, box, strict=True)
    ]
    height = 1.2 + 0.24 * models
    return Picture(tuple(charts), len(charts), height=height, shared="y")


def _extent(extent: Mapping[str, float], limits: np.ndarray):
    """(low, centre or None, high): one width on either side, or between borders."""
    if "centre" in extent:
        centre, width = extent["centre"], extent["width"]
        return centre - width, centre, centre + width
    low, high = limits.tolist()
    return extent.get("above", low), None, extent.get("below", high)
