"""Figure of the test processes: noise-free output, free runs, and the partitions."""

from typing import Any

import jax.numpy as jnp
import matplotlib.figure
import numpy as np

import jaxnarx as jnx

SHOWN = 400
"""Samples of the test record that are drawn."""
COLOURS = {"LOLIMOT": "tab:orange", "staged": "tab:blue"}


def draw(
    examples: dict[str, tuple[dict[str, jnx.Network], jnx.Dataset]],
) -> matplotlib.figure.Figure:
    """One row a process: its test record, then the regions before and after."""
    figure = matplotlib.figure.Figure(
        figsize=(11, 0.6 + 2.3 * len(examples)), layout="constrained"
    )
    grid = figure.add_gridspec(len(examples), 3, width_ratios=(2.6, 1, 1))
    for row, (name, (networks, test)) in enumerate(examples.items()):
        axes = figure.add_subplot(grid[row, 0])
        trace(axes, networks, test)
        axes.set_title(name, fontsize=9, loc="left")
        for column, kind in enumerate(COLOURS, start=1):
            axes = figure.add_subplot(grid[row, column])
            regions(axes, networks[kind])
            title = "regions by LOLIMOT" if kind == "LOLIMOT" else "refined"
            axes.set_title(title, fontsize=9, loc="left")
        if row == len(examples) - 1:
            figure.axes[-3].set_xlabel("sample of a record that took no part")
    return figure


def trace(axes, networks: dict[str, jnx.Network], test: jnx.Dataset) -> None:
    """The noise-free output and the free runs before and after refinement."""
    y = test.records[0].y[:SHOWN, 0]
    axes.plot(y, color="black", linewidth=2.4, label="noise-free output")
    for kind, colour in COLOURS.items():
        run = jnx.simulate(networks[kind], test).value[0][:SHOWN, 0]
        label = "free run, " + ("LOLIMOT" if kind == "LOLIMOT" else "refined")
        axes.plot(run, color=colour, linewidth=1, label=label)
    axes.set_ylabel("y [-]")
    axes.set_ylim(top=y.max() + 0.3 * np.ptp(y))
    axes.legend(frameon=False, fontsize=7, ncols=3, loc="upper left")
    axes.spines[["top", "right"]].set_visible(False)


def regions(axes, network: jnx.Network) -> None:
    """Which local model leads where, or the weights along one scheduling variable."""
    (model,) = network.models
    low = np.asarray(model.offset)
    high = low + np.asarray(model.span)
    centres = [
        [v["centre"] for v in entry["region"].values()] for entry in network.equations()
    ]
    names = list(network.equations()[0]["region"])
    axes.set_xlabel(f"{names[0]} [-]", fontsize=8)
    if len(names) == 1:
        z = np.linspace(0, 1, 200)[None]
        x = low[0] + z[0] * (high[0] - low[0])
        axes.plot(x, weights(model, z).T, linewidth=1.2)
        axes.plot([c[0] for c in centres], [0] * len(centres), "ko", markersize=3)
        axes.set_ylabel("weight [-]", fontsize=8)
        return
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 120)] * 2), axis=0)
    axes.imshow(
        weights(model, grid).argmax(axis=0),
        origin="lower",
        extent=(low[0], high[0], low[1], high[1]),
        aspect="auto",
        cmap="Pastel1",
    )
    for centre in centres:
        axes.plot(*centre, "ko", markersize=3, clip_on=False)
    axes.set_ylabel(f"{names[1]} [-]", fontsize=8)


def weights(model: Any, z: np.ndarray) -> np.ndarray:
    """Validity of every local model at scaled scheduling values."""
    return np.asarray(model.validity(jnp.asarray(z), model.active))
