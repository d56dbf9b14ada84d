"""The README's figure: the demo's free run and its partition, before and after.

Run as `python experiments/demo/figure.py [--out FILE] [--smoke]`.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.figure
import numpy as np

import jaxnarx as jnx
from jaxnarx.engines import pfi_siso_records

SEED = 1
EVENTS = 2000
SCHEDULING = ("duty[t-3]", "speed[t-1]")


def identify(events: int, steps: int):
    """The networks before and after refinement, and the test record."""
    data = pfi_siso_records(jax.random.key(SEED), (events,) * 3)
    train, validate, test = data[0], data[1], data[2]
    pool = jnx.polynomial_pool(
        train.channels,
        input_lags=(2, 3, 4, 6, 8, 12, 16, 24),
        output_lags=(1, 2),
        degree=1,
    )
    terms = jnx.select(pool, train, jnx.ForwardOLS(max_terms=10)).value
    method = jnx.Lolimot(scheduling=SCHEDULING, max_models=4)
    grown = jnx.grow(terms, train, method).value
    settings = jnx.SimulationError(max_steps=steps, window_steps=min(steps, 20))
    fit = jnx.refine(grown, train, settings, validation=validate).value
    return grown, fit, test


def regions(axes, network: jnx.Network, title: str) -> None:
    """Which local model leads where, in physical units."""
    model = network.models[0]
    low, span = np.asarray(model.offset), np.asarray(model.span)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 160)] * 2), axis=0)
    weight = np.asarray(model.validity(jnp.asarray(grid), model.active))
    extent = (low[0], low[0] + span[0], low[1], low[1] + span[1])
    axes.imshow(
        weight.argmax(axis=0),
        origin="lower",
        extent=extent,
        aspect="auto",
        cmap="Pastel1",
    )
    for entry in network.equations():
        centre = [v["centre"] for v in entry["region"].values()]
        axes.plot(*centre, "o", color="black", markersize=4, clip_on=False)
    axes.set_title(title, fontsize=9, loc="left")
    axes.set_ylabel("speed [rpm]")


def draw(before: jnx.Network, after: jnx.Network, test: jnx.Dataset):
    figure = matplotlib.figure.Figure(figsize=(10, 4.2), layout="constrained", dpi=110)
    grid = figure.add_gridspec(2, 2, width_ratios=(2.4, 1))
    time = np.arange(test.samples) * test.sample_time
    y = test.records[0].y[:, 0]
    trace, error = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    trace.plot(time, y, color="black", linewidth=2.2, label="measured")
    runs = ((before, "LOLIMOT", "tab:orange"), (after, "refined", "tab:blue"))
    for network, label, colour in runs:
        run = jnx.simulate(network, test).value[0][:, 0]
        rmse = np.sqrt(np.mean((run - y)[24:] ** 2))
        trace.plot(time, run, color=colour, linewidth=1, label=f"free run, {label}")
        error.plot(
            time, run - y, color=colour, linewidth=1, label=f"{rmse:.1f} rpm RMSE"
        )
    trace.set_ylabel("speed [rpm]")
    error.set_ylabel("error [rpm]")
    error.set_xlabel("time [s at 1000 rpm], a record that took no part")
    for axes in (trace, error):
        axes.legend(frameon=False, fontsize=8, ncols=3, loc="upper left")
        axes.spines[["top", "right"]].set_visible(False)
    trace.set_ylim(top=y.max() + 0.25 * np.ptp(y))
    regions(figure.add_subplot(grid[0, 1]), before, "regions by LOLIMOT")
    last = figure.add_subplot(grid[1, 1])
    regions(last, after, "refined on the free run")
    last.set_xlabel("duty [-]")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=str(Path(__file__).with_name("demo.png")))
    parser.add_argument("--smoke", action="store_true", help="a small, quick run")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    events, steps = (400, 1) if options.smoke else (EVENTS, 40)
    draw(*identify(events, steps)).savefig(options.out)


if __name__ == "__main__":
    main()
