"""Figures of single models: thesis figures 5.5, 6.8 to 6.14, 6.18 to 6.21, 7.1 to 7.5,
and Table 6.1.

The networks of the experiments on sections 5.2, 6.3, 6.4 and 7.2, their first seed:
channels, weights of the local models, partition stage by stage, and the estimates of
the unseen record beside the measurement, those of a perceptron as well. What the models
are, and how they differ from the thesis's, stands in those experiments, which judge
them over all seeds. Section 6.3: four local models of five cubic regressors by F,
without refinement, and a perceptron of five units trained in the free run. Section 6.4:
five local models. Section 7.2: three regions, for the torque with the gate at 2,000 rpm
of figure 7.2 and terms by F, for the air-fuel ratio grown and by ERR.

Run as `python experiments/thesis/multi_model_figures.py [--smoke] [--results DIR]`.
Writes Table 6.1 to multi_model_figures.json, and the figures

    chapter5_channels             5.5        chapter6_weights_lolimot      6.20
    chapter6_weights_local        6.8        chapter6_validation           6.21
    chapter6_channels             6.10       chapter7_channels             7.1
    chapter6_estimates            6.11-6.14  chapter7_regions_TRQ, _AFR    7.2, 7.3
    chapter6_lolimot_channels     6.18       chapter7_estimates            7.4, 7.5
    chapter6_process              6.19
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import chapter5_miso
import chapter6_local_models as local
import chapter6_lolimot as lolimot
import chapter7_forward as forward
import jax
import numpy as np
from chapter6_tables import FIVE
from matplotlib.figure import Figure
from multi_models import (
    PARTS,
    chosen,
    parsed,
    record,  # pyright: ignore[reportAttributeAccessIssue]
    table,
)
from neural import Budget, Lesson, neural_run, train
from validity_surface import validity_surface

import jaxnarx as jnx
from jaxnarx.engines import PfiDyno, records
from jaxnarx.evaluation import describe_partition
from jaxnarx.metrics import scores
from jaxnarx.shell.figures.style import BLUE, INK_COLOUR, canvas, save, tone, use_style
from jaxnarx.simulation import Trajectories

NAME = "multi_model_figures"
SPEED = 1750.0
"""Centre of the region of Table 6.1 [rpm]."""
MODELS = 5
"""Local models of figures 6.19 and 6.20."""
Estimates = tuple[jnx.Channel, str, np.ndarray, np.ndarray, np.ndarray]
"""Output, title, and of the unseen record measurement, run, and where it counts."""
Kept = partial[None]


def draw_channels(data: jnx.Dataset) -> Figure:
    """Every signal of the first record, one below the other."""
    (first,) = data.records
    values = np.concatenate([first.u, first.y], axis=1)
    with use_style():
        height = 0.9 * values.shape[1] + 0.6
        figure, axes = canvas(9.0, height, rows=values.shape[1], sharex=True)
        for ax, channel, x in zip(axes, data.channels.all, values.T, strict=True):
            ax.plot(x, color=BLUE, lw=0.8)
            ax.set_ylabel(f"{channel.name}\n[{channel.unit}]")
        axes[-1].set(xlabel="sample", xlim=(0, len(values) - 1))
        figure.align_ylabels(axes)
    return figure


def draw_estimates(found: Sequence[Estimates]) -> Figure:
    """Measurement and model on unseen records, with R2, one below the other."""
    with use_style():
        figure, axes = canvas(9.0, 1.7 * len(found) + 0.4, rows=len(found))
        for ax, (channel, title, y, run, counts) in zip(axes, found, strict=True):
            r2 = scores(y[:, None], run[:, None], counts[:, None])["r2"][0]
            ax.plot(y, color=INK_COLOUR, lw=1.3, label="measured")
            ax.plot(run, color=BLUE, lw=0.9, label="model")
            room = 0.2 * np.ptp(y)
            ax.set(title=f"{title}: R2 {r2:.3f}", ylabel=channel.label)
            ax.set(xlim=(0, len(y) - 1), ylim=(y.min() - room, y.max() + room))
        axes[-1].set_xlabel("sample")
        axes[0].legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return figure


def draw_process(stages: Sequence[jnx.Network], data: jnx.Dataset) -> Figure:
    """The model that leads at every place, after each split."""
    entries = [describe_partition(stage, data=data)["TRQ"] for stage in stages]
    with use_style():
        figure, axes = canvas(9.0, 2.6, columns=len(entries), sharex=True, sharey=True)
        for n, (ax, entry) in enumerate(zip(axes, entries, strict=True)):
            weights = np.asarray(entry["after"]["weights"])
            sides = zip(entry["ranges"], weights.shape[1:], strict=True)
            grid = [np.linspace(low, high, size) for (low, high), size in sides]
            lead = weights.argmax(axis=0).T
            for m in range(len(weights)):
                level = {"levels": [0.5, 1.5], "colors": [tone(m)], "alpha": 0.4}
                ax.contourf(*grid, (lead == m).astype(float), **level)
            ax.plot(
                *np.asarray(entry["cloud"]).T, ".", color=INK_COLOUR, ms=1.2, alpha=0.4
            )
            ax.set(title=f"{n + 2} local models", xlabel=entry["scheduling"][0])
        axes[0].set_ylabel(entries[0]["scheduling"][1])
    return figure


def estimated(title: str, unseen: jnx.Dataset, run: Trajectories) -> Estimates:
    """The unseen record of one output, as a run follows it."""
    y = unseen.records[0].y[:, 0]
    return unseen.channels.outputs[0], title, y, run[0][:, 0], run.scored[0][:, 0]


def table_6_1(data: jnx.Dataset, sizes: int) -> dict[str, list[dict[str, Any]]]:
    """Terms of the model at 1750 rpm in order of choice, with its partial F or ERR.

    Weighted with the validity of the region above the last border.
    """
    pool, train_ = local.pool_of(data, 3, local.EVERY), data[:1]
    u = train_.records[0].u
    speed = u[:, [c.name for c in data.channels.inputs].index("RPM")]
    weight = 1 / (1 + np.exp(-local.STEEPNESS * (speed - local.BORDERS[-1])))
    out = {}
    for how in local.METHODS:
        method = local.method_of(how, sizes, 3)
        found = jnx.select(pool, train_, method, weights=[weight])
        names, err = found.value.names, found.value.err[0]
        rows = [
            {"term": name, "ERR": float(e)} for name, e in zip(names, err, strict=False)
        ]
        if how == "F":
            rows[-1]["partial F by term"] = found.stats["history"][0][-1]
        out[how] = rows
    return out


def section_6_3(kept: Kept, length: int, smoke: bool) -> None:
    """Weights, test signals, and estimates beside those of a perceptron."""
    budget = Budget(50, 20, 5, (10,)) if smoke else Budget()
    structure = "local linear" if smoke else "local cubic"
    method = local.method_of("F", FIVE, local.STRUCTURES[structure][1])
    shown, terms = [], {}
    for output, data in local.bench(0, length).items():
        unseen, pool = data[2:3], local.pool_of(data, 1, local.EVERY)
        network = local.network_of(data, structure, method)
        run = jnx.simulate(network, unseen).value
        shown.append(estimated(f"{output}, local models", unseen, run))
        width, key = 2 if smoke else 5, jax.random.key(0)
        (nets,) = train([Lesson(pool, data[:1], data[1:2], width, key)], budget)
        run = neural_run(nets["NOE"], unseen, one_step=False)
        shown.append(estimated(f"{output}, perceptron", unseen, run))
        if output == "TRQ":
            kept(jnx.plot.partition(network, data[:1]), "chapter6_weights_local")
            kept(draw_channels(unseen), "chapter6_channels")
            terms = table_6_1(data, FIVE)
    kept(draw_estimates(shown), "chapter6_estimates")
    for how, rows in terms.items():
        print(f"\nTable 6.1, {how}\n{table(rows, {'term': '', 'ERR': '.3g'})}")
    record(NAME, {"table_6_1": terms, "speed": SPEED}, folder=kept.args[0])


def section_6_4(kept: Kept, length: int) -> None:
    """Data, partition stage by stage, weights and validation of LOLIMOT."""
    measured = records(PfiDyno(), jax.random.key(0), [length] * 3, names=PARTS)
    data = chosen(measured, lolimot.INPUTS, lolimot.OUTPUT, lolimot.BED)
    pool = jnx.polynomial_pool(
        data.channels, input_lags=lolimot.LAGS, output_lags=lolimot.LAGS, degree=1
    )
    method = jnx.Lolimot(
        lolimot.SCHEDULING, max_models=MODELS, criterion="none", worst="nmse"
    )
    grown, unseen = jnx.grow(pool, data[:1], method), data[2:3]
    kept(draw_channels(data[:1]), "chapter6_lolimot_channels")
    kept(draw_process(grown.stats["stages"][0][1:], data[:1]), "chapter6_process")
    kept(validity_surface(grown.value), "chapter6_weights_lolimot")
    free, one = (run(grown.value, unseen).value for run in (jnx.simulate, jnx.predict))
    shown = [estimated("free run", unseen, free), estimated("one step", unseen, one)]
    kept(draw_estimates(shown), "chapter6_validation")


def section_7_2(kept: Kept, smoke: bool) -> None:
    """Inputs, gates and regions, and estimates."""
    shown = []
    for output, data in forward.bench(0, 400 if smoke else forward.LENGTH).items():
        how, unseen = "F" if output == "TRQ" and not smoke else "ERR", data[2:3]
        tree = forward.GIVEN if output == "TRQ" else forward.AXIS
        network = forward.network_of(data, tree, how, forward.REGIONS)
        kept(jnx.plot.partition(network, data[:1]), f"chapter7_regions_{output}")
        run = jnx.simulate(network, unseen).value
        shown.append(estimated(f"{output}, three regions, {how}", unseen, run))
        if output == "TRQ":
            kept(draw_channels(data[:1]), "chapter7_channels")
    kept(draw_estimates(shown), "chapter7_estimates")


def keep(folder: Path, figure: Figure, name: str) -> None:
    save(figure, folder / f"{name}.png")


def main() -> None:
    options = parsed(__doc__ or "", "short records, a small perceptron")
    jax.config.update("jax_enable_x64", True)
    smoke, kept = options.smoke, partial(keep, options.results)
    length = 300 if smoke else local.LENGTH
    kept(draw_channels(chapter5_miso.bench(0, length)["TRQ"][:1]), "chapter5_channels")
    section_6_4(kept, length)
    section_7_2(kept, smoke)
    section_6_3(kept, length, smoke)


if __name__ == "__main__":
    main()
