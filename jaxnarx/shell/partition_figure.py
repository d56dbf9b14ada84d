"""Where the local models are valid, before and after refinement.

One scheduling variable: validity over its range. Two: a map of the regions with centres
and widths. More: every model's centre and width in each variable.

A model is a dict of `centre` and `width`, a number per scheduling variable in that
variable's unit; validity is the normalised Gaussian (6.5), (6.6) of the thesis.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from jaxnarx.shell.style import BLUE, CYCLE, GREY, INK, canvas, plain, styled

CLOUD = 1500


def partition(
    scheduling: Sequence[str],
    ranges: Sequence[Sequence[float | int] | np.ndarray] | np.ndarray,
    before: Sequence[Mapping[str, Any]] = (),
    after: Sequence[Mapping[str, Any]] = (),
    *,
    cloud: Float[np.ndarray, "samples dims"] | None = None,
) -> Figure:
    """The partition before and after, side by side (or the one that is given).

    `ranges` are the (low, high) of each scheduling variable in the training data;
    `cloud` are data points, evenly thinned to at most 1500. Widths and centres outside
    the range are drawn where they fall in it.
    """
    sides = [(t, _arrays(m)) for t, m in _titled(before, after) if len(m)]
    names = [plain(name) for name in scheduling]
    box = np.asarray(ranges, float).reshape(len(names), 2)
    points = _thinned(cloud)
    with styled():
        if len(names) == 1:
            return _curves(names[0], box[0], sides, points)
        if len(names) == 2:
            return _maps(names, box, sides, points)
        return _spans(names, box, sides)


def validity(
    z: Float[np.ndarray, "samples dims"],
    centre: Float[np.ndarray, "models dims"],
    width: Float[np.ndarray, "models dims"],
) -> Float[np.ndarray, "samples models"]:
    """Normalised Gaussians (6.5), (6.6), for drawing; far away they still sum to 1."""
    scaled = (z[:, None, :] - centre[None]) / width[None]
    logit = -0.5 * np.sum(scaled**2, axis=-1)
    weight = np.exp(logit - logit.max(axis=1, keepdims=True))
    return weight / weight.sum(axis=1, keepdims=True)


def _titled(before, after) -> list[tuple[str, Sequence[Mapping[str, Any]]]]:
    """Both sides by name; one alone needs none."""
    if not len(before) or not len(after):
        return [("", before), ("", after)]
    return [("before refinement", before), ("after refinement", after)]


def _arrays(models: Sequence[Mapping[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    centre = np.array([np.atleast_1d(m["centre"]) for m in models], float)
    width = np.array([np.atleast_1d(m["width"]) for m in models], float)
    return centre, np.maximum(np.abs(width), 1e-12 * (1 + np.abs(centre)))


def _thinned(cloud: np.ndarray | None) -> np.ndarray | None:
    if cloud is None or len(cloud) == 0:
        return None
    cloud = np.asarray(cloud, float).reshape(len(cloud), -1)
    return cloud[np.unique(np.linspace(0, len(cloud) - 1, CLOUD).astype(int))]


def _curves(name: str, box: np.ndarray, sides, points) -> Figure:
    figure, axes = canvas(9.0, 2.6, columns=max(len(sides), 1), sharey=True)
    z = np.linspace(box[0], box[1], 300)
    for ax, (title, (centre, width)) in zip(axes, sides, strict=False):
        weights = validity(z[:, None], centre, width)
        for m, weight in enumerate(weights.T):
            color = CYCLE[m % len(CYCLE)]
            ax.plot(z, weight, color=color)
            if box[0] <= centre[m, 0] <= box[1]:
                ax.plot(centre[m, 0], 1.06, color=color, marker="v", ms=5, ls="")
        if points is not None:
            rug = {"color": INK, "marker": "|", "ms": 5, "ls": "", "alpha": 0.25}
            ax.plot(points[:300, 0], np.full(len(points[:300]), -0.06), **rug)
        ax.set(title=title, xlabel=name, ylim=(-0.12, 1.14), xlim=box)
    axes[0].set_ylabel("validity")
    return figure


def _maps(names: list[str], box: np.ndarray, sides, points) -> Figure:
    shared = {"sharex": True, "sharey": True}
    figure, axes = canvas(9.0, 4.0, columns=max(len(sides), 1), **shared)
    for ax, (title, (centre, width)) in zip(axes, sides, strict=False):
        _map(ax, box, centre, width)
        if points is not None:
            dots = {"color": GREY, "marker": ".", "ms": 2.2, "ls": "", "mew": 0}
            ax.plot(*points.T, alpha=0.6, rasterized=True, zorder=1.5, **dots)
        ax.set(title=title, xlabel=names[0], xlim=box[0], ylim=box[1])
        ax.grid(visible=False)
    axes[0].set_ylabel(names[1])
    return figure


def _map(axes: Axes, box: np.ndarray, centre: np.ndarray, width: np.ndarray) -> None:
    """Regions coloured by the model that leads, paler where it leads by little."""
    grid = [np.linspace(low, high, 160) for low, high in box]
    z = np.stack(np.meshgrid(*grid), axis=-1)
    weights = validity(z.reshape(-1, 2), centre, width).reshape(*z.shape[:2], -1)
    color = np.array([to_rgb(CYCLE[m % len(CYCLE)]) for m in range(len(centre))])
    lead = weights.argmax(axis=-1)
    image = np.concatenate([color[lead], 0.45 * weights.max(-1)[..., None]], axis=-1)
    extent = (*box[0], *box[1])
    axes.imshow(image, extent=extent, origin="lower", aspect="auto", zorder=0.5)
    for m in range(len(centre)):
        others = np.delete(weights, m, axis=-1)
        if np.any(lead == m) and not np.all(lead == m):
            ahead = weights[..., m] - others.max(axis=-1)
            axes.contour(*grid, ahead, levels=[0], colors=[INK], linewidths=0.7)
        tone = CYCLE[m % len(CYCLE)]
        size = 2 * width[m]
        ring = Ellipse(tuple(centre[m]), *size, fill=False, ec=tone, lw=1.1)
        axes.add_patch(ring)
        axes.plot(*centre[m], color=tone, marker="o", ms=5, mec="white", mew=0.8)
        axes.annotate(
            str(m + 1),
            tuple(centre[m]),
            xytext=(4, 3),
            textcoords="offset points",
            annotation_clip=True,
        )


def _spans(names: list[str], box: np.ndarray, sides) -> Figure:
    models = max((len(c) for _, (c, _) in sides), default=1)
    height = 1.2 + 0.24 * models
    figure, axes = canvas(9.0, height, columns=len(names), sharey=True)
    tones = (INK, BLUE) if len(sides) == 2 else (BLUE,)
    for s, (title, (centre, width)) in enumerate(sides):
        at = np.arange(len(centre)) + 1 + 0.24 * (s - 0.5 * (len(sides) - 1))
        for d, ax in enumerate(axes):
            bar = {"color": tones[s], "marker": "o", "ms": 3.5, "ls": "", "lw": 1.6}
            ax.errorbar(centre[:, d], at, xerr=width[:, d], label=title, **bar)
            ax.set(xlabel=names[d], xlim=box[d])
    axes[0].set(ylabel="local model", yticks=np.arange(models) + 1)
    axes[0].invert_yaxis()
    if len(sides) == 2:
        axes[0].legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    return figure
