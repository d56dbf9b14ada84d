"""Where the local models are valid, before and after refinement.

One scheduling variable: validity over its range. Two: a map of the regions. More: every
model's extent in each variable, or the tree. Weights come from the network itself, see
`jaxnarx.evaluation.describe_partition`; nothing here knows a validity function.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from scipy.ndimage import distance_transform_edt

from jaxnarx.shell.figures.style import (
    BLUE,
    GREY,
    INK_COLOUR,
    canvas,
    plain_text,
    tone,
    use_style,
)
from jaxnarx.shell.figures.tree import tree

MAX_DATA_POINTS = 1500
"""Data points drawn."""

Side = Mapping[str, Any]
"""`regions`, and where known `weights`, of one partition."""


def partition(entry: Mapping[str, Any]) -> Figure:
    """The partition of one output, an entry of `describe_partition`.

    Before and after stand side by side where both are there. Widths and centres outside
    the range are drawn where they fall in it; at most 1500 points of the cloud are
    drawn.
    """
    names = [plain_text(name) for name in entry["scheduling"]]
    box = np.asarray(entry["ranges"], float).reshape(len(names), 2)
    sides = _title_sides(entry)
    points = _thin(entry.get("cloud"))
    drawable = all("weights" in side for _, side in sides)
    if not drawable and "gates" in entry["after"]:
        return tree(entry)
    with use_style():
        if drawable and len(names) == 1:
            return _curves(names[0], box[0], sides, points)
        if drawable:
            return _maps(names, box, sides, points)
        return _spans(entry["scheduling"], box, sides)


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


def _curves(name: str, box: np.ndarray, sides, points) -> Figure:
    figure, axes = canvas(9.0, 2.6, columns=len(sides), sharey=True)
    for ax, (title, side) in zip(axes, sides, strict=True):
        weights = np.asarray(side["weights"], float)
        z = np.linspace(box[0], box[1], weights.shape[1])
        for m, weight in enumerate(weights):
            ax.plot(z, weight, color=tone(m))
            _name_curve(ax, m, z, weight, weight >= weights.max(axis=0))
        if points is not None:
            rug = {"color": INK_COLOUR, "marker": "|", "ms": 5, "ls": "", "alpha": 0.25}
            ax.plot(points[:300, 0], np.full(len(points[:300]), -0.06), **rug)
        ax.set(title=title, xlabel=name, ylim=(-0.12, 1.18), xlim=box)
    axes[0].set_ylabel("validity")
    return figure


def _name_curve(axes: Axes, m: int, z, weight, leads: Bool[np.ndarray, " grid"]):
    """The number above the middle of where a model leads, or else at its peak."""
    at = float(z[leads].mean()) if leads.any() else float(z[weight.argmax()])
    height = 1.03 if leads.any() else float(weight.max())
    look: dict[str, Any] = {"ha": "center", "va": "bottom", "fontweight": "bold"}
    axes.text(at, height, str(m + 1), color=tone(m), **look)


def _maps(names: list[str], box: np.ndarray, sides, points) -> Figure:
    shared = {"sharex": True, "sharey": True}
    figure, axes = canvas(9.0, 4.0, columns=len(sides), **shared)
    for ax, (title, side) in zip(axes, sides, strict=True):
        named = [_centre(ax, m, box, r) for m, r in enumerate(side["regions"])]
        _map(ax, box, np.asarray(side["weights"], float), named)
        if points is not None:
            dots = {"color": GREY, "marker": ".", "ms": 2.2, "ls": "", "mew": 0}
            ax.plot(*points.T, alpha=0.6, rasterized=True, zorder=1.5, **dots)
        ax.set(title=title, xlabel=names[0], xlim=box[0], ylim=box[1])
        ax.grid(visible=False)
    axes[0].set_ylabel(names[1])
    return figure


def _map(
    axes: Axes,
    box: np.ndarray,
    weights: Float[np.ndarray, "models _ _"],
    named: Sequence[bool],
) -> None:
    """Regions coloured by the model that leads, paler where it leads by little.

    Lines run where two models are equal; the number of a model that is not `named`
    already stands where its border is farthest.
    """
    weights = np.swapaxes(weights, 1, 2)
    color = np.array([to_rgb(tone(m)) for m in range(len(weights))])
    lead = weights.argmax(axis=0)
    alpha = 0.45 * weights.max(axis=0)[..., None]
    image = np.concatenate([color[lead], alpha], axis=-1)
    # Pixels lie around the points of the grid, also around those on the edge.
    half = 0.5 * np.diff(box, axis=1)[:, 0] / (np.array(lead.shape[::-1]) - 1)
    left, right, low, high = (box + np.outer(half, [-1, 1])).ravel().tolist()
    extent = (left, right, low, high)
    axes.imshow(image, extent=extent, origin="lower", aspect="auto", zorder=0.5)
    sides = zip(box, lead.shape[::-1], strict=True)
    grid = [np.linspace(a, b, n) for (a, b), n in sides]
    for m in range(len(weights)):
        own = lead == m
        if not own.any():
            continue
        ahead = weights[m] - np.delete(weights, m, axis=0).max(axis=0)
        if not own.all():
            axes.contour(*grid, ahead, levels=[0], colors=[INK_COLOUR], linewidths=0.7)
        if not named[m]:
            inside = np.asarray(distance_transform_edt(np.pad(own, 1)))[1:-1, 1:-1]
            row, column = np.unravel_index(inside.argmax(), inside.shape)
            place = float(grid[0][column]), float(grid[1][row])
            look = {"ha": "center", "va": "center", "fontweight": "bold", "zorder": 4}
            axes.text(*place, str(m + 1), color=INK_COLOUR, **look)


def _centre(
    axes: Axes, m: int, box: np.ndarray, region: Mapping[str, Mapping[str, float]]
) -> bool:
    """Dot, ring and number of a model that has a centre and widths; its number shows
    only where the centre does."""
    extents = list(region.values())
    if len(extents) != 2 or not all("centre" in e for e in extents):
        return False
    centre = extents[0]["centre"], extents[1]["centre"]
    size = [2 * e["width"] for e in extents]
    ring = Ellipse(centre, *size, fill=False, ec=tone(m), lw=1.0, alpha=0.8)
    axes.add_patch(ring)
    axes.plot(*centre, color=tone(m), marker="o", ms=4.5, mec="white", mew=0.8)
    if np.any(np.array(centre) < box[:, 0]) or np.any(np.array(centre) > box[:, 1]):
        return False
    look = {"textcoords": "offset points", "fontweight": "bold", "zorder": 4}
    axes.annotate(str(m + 1), centre, xytext=(4, 3), color=INK_COLOUR, **look)
    return True


def _spans(scheduling: Sequence[str], box: np.ndarray, sides) -> Figure:
    """Every model's extent in each variable, one axes per variable."""
    models = max(len(side["regions"]) for _, side in sides)
    height = 1.2 + 0.24 * models
    figure, axes = canvas(9.0, height, columns=len(scheduling), sharey=True)
    tones = (GREY, BLUE) if len(sides) == 2 else (BLUE,)
    for s, (title, side) in enumerate(sides):
        offset = 0.24 * (s - 0.5 * (len(sides) - 1))
        for m, region in enumerate(side["regions"]):
            for ax, name, limits in zip(axes, scheduling, box, strict=True):
                low, centre, high = _extent(region.get(name, {}), limits)
                at = m + 1 + offset
                label = title if m == 0 else None
                ax.plot([low, high], [at, at], color=tones[s], lw=1.8, label=label)
                if centre is not None:
                    ax.plot(centre, at, color=tones[s], marker="o", ms=4)
    for ax, name, limits in zip(axes, scheduling, box, strict=True):
        ax.set(xlabel=plain_text(name), xlim=limits)
    axes[0].set(ylabel="local model", yticks=np.arange(models) + 1)
    axes[0].set_ylim(models + 0.6, 0.4)
    if len(sides) == 2:
        axes[0].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    return figure


def _extent(extent: Mapping[str, float], limits: np.ndarray):
    """(low, centre or None, high): one width on either side, or between borders."""
    if "centre" in extent:
        centre, width = extent["centre"], extent["width"]
        return centre - width, centre, centre + width
    low, high = limits.tolist()
    return extent.get("above", low), None, extent.get("below", high)
