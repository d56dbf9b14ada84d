"""Figures of thesis chapters 5 to 7 that show one engine and one seed, and Table 6.1.

The beds, records, structures and settings are those of the experiments of each chapter
(`chapter5_miso.py`, `chapter6_local_models.py`, `chapter6_lolimot.py`,
`chapter7_forward.py`), where scores over five or ten seeds stand; here is what the
thesis prints as a picture: 5.5 input channels; 6.8 weights over speed; 6.10 test signal
and 6.11 to 6.14 estimates of the local models beside the perceptron; 6.18 LOLIMOT's
data, 6.19 how it partitions, 6.20 its weighting curves, 6.21 its validation; 7.1
inputs, 7.2 gates, 7.3 regions, 7.4 and 7.5 estimated beside measured. Estimates are
free runs of the validation record. Table 6.1: the terms of the local torque model at
1750 rpm as they enter, with the partial F of all at every step, and with ERR.

Run as `python experiments/thesis/single_seed.py [--smoke] [--results DIR]`; a few
minutes. Writes figure_*.png and prints the table.
"""

from collections.abc import Mapping, Sequence

import chapter5_miso as miso
import chapter6_local_models as local
import chapter6_lolimot as lolimot
import chapter7_forward as forward
import jax
import numpy as np
from chapter5_tables import f_table
from matplotlib.figure import Figure
from multi_models import PARTS, chosen, parsed
from neural import Budget, neural_run, train

import jaxnarx as jnx
from jaxnarx.engines import PfiDyno, records
from jaxnarx.evaluation import describe_partition
from jaxnarx.shell.partition_figure import partition
from jaxnarx.shell.style import BLUE, INK, ORANGE, canvas, save, styled, tone

SEED, GROWN = 0, 5
"""LOLIMOT of figure 6.19 ends with five local models."""
TORQUE = "TRQ"


def channels(data: jnx.Dataset, record: int = 0) -> Figure:
    """Every channel of a record over its samples."""
    rows, every = data.records[record], data.channels.all
    table = np.concatenate([rows.u, rows.y], axis=1)
    with styled():
        figure, axes = canvas(9.0, 1.1 * len(every), rows=len(every), sharex=True)
        for ax, channel, column in zip(axes, every, table.T, strict=True):
            ax.plot(column, color=INK, lw=0.8)
            ax.set_ylabel(channel.label, rotation=0, ha="right", va="center")
        axes[-1].set_xlabel("sample")
        figure.align_ylabels(axes)
    return figure


def estimates(data: jnx.Dataset, runs: Mapping[str, np.ndarray]) -> Figure:
    """The measured output and what models make of it, each over its own axes."""
    channel, measured = data.channels.outputs[0], data.records[0].y[:, 0]
    with styled():
        size = {"rows": len(runs), "sharex": True, "sharey": True}
        figure, axes = canvas(9.0, 2.2 * len(runs), **size)
        for ax, (name, run), color in zip(
            axes, runs.items(), (BLUE, ORANGE), strict=False
        ):
            ax.plot(measured, color=INK, lw=1.4, label="measured")
            ax.plot(run, color=color, lw=0.9, label=name)
            ax.set_ylabel(channel.label)
            ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
        axes[-1].set_xlabel("sample")
    return figure


def free_run(network: jnx.Network, data: jnx.Dataset) -> np.ndarray:
    return jnx.simulate(network, data).value.outputs[0][:, 0]


def partitions(networks: Sequence[jnx.Network]) -> Figure:
    """The same scheduling space as growth divides it, one axes per step."""
    with styled():
        size = {"columns": len(networks), "sharex": True, "sharey": True}
        figure, axes = canvas(10.0, 2.4, **size)
        for ax, network in zip(axes, networks, strict=True):
            (entry,) = describe_partition(network).values()
            lead = np.asarray(entry["after"]["weights"]).argmax(axis=0).T
            (left, right), (low, high) = entry["ranges"]
            box = (left, right, low, high)
            colors = np.array([tone(m) for m in range(lead.max() + 1)])
            grid = [
                np.linspace(*pair, n)
                for pair, n in zip(entry["ranges"], lead.shape[::-1], strict=True)
            ]
            levels = np.arange(lead.max() + 2) - 0.5
            ax.contourf(*grid, lead, levels=levels, colors=colors, alpha=0.35)
            for m, region in enumerate(entry["after"]["regions"]):
                place = [extent["centre"] for extent in region.values()]
                ax.text(*place, str(m + 1), ha="center", va="center")
            ax.set(xlabel=entry["scheduling"][0], xlim=box[:2], ylim=box[2:])
            ax.set_title(f"{len(entry['after']['regions'])} local models")
        axes[0].set_ylabel(entry["scheduling"][1])
    return figure


def curves(network: jnx.Network) -> Figure:
    """Every local model's Gaussian along each scheduling variable, not normalised."""
    (entry,) = describe_partition(network).values()
    names = entry["scheduling"]
    with styled():
        figure, axes = canvas(9.0, 2.6, columns=len(names), sharey=True)
        for ax, name, (low, high) in zip(axes, names, entry["ranges"], strict=True):
            z = np.linspace(low, high, 300)
            for m, region in enumerate(entry["after"]["regions"]):
                at = (z - region[name]["centre"]) / region[name]["width"]
                ax.plot(z, np.exp(-0.5 * at**2), color=tone(m), label=str(m + 1))
            ax.set_xlabel(name)
        axes[0].set_ylabel("weight before normalisation")
        axes[-1].legend(title="model", loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def gate(border: float, steepness: float, span: Sequence[float]) -> Figure:
    """Both sides of one sigmoid gate (7.1, 7.2)."""
    x = np.linspace(*span, 300)
    open_ = 1.0 / (1.0 + np.exp(-steepness * (x - border)))
    with styled():
        figure, (ax,) = canvas(5.0, 2.4)
        ax.plot(x, 1.0 - open_, color=BLUE, label="below")
        ax.plot(x, open_, color=ORANGE, label="above")
        ax.set(xlabel="RPM [rpm]", ylabel="weight")
        ax.set_title(f"border {border:g}, steepness {steepness:g}", pad=18)
        ax.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    return figure


def table_6_1(data: jnx.Dataset) -> str:
    """Terms of the torque at 1750 rpm in order of entry, by F and by ERR."""
    pool, train = local.pool_of(data, 3, local.EVERY), data[:1]
    # The last of the log-sigmoids: half at the border below, one far above.
    speed = train.records[0].u[:, [c.name for c in local.INPUTS].index("RPM")]
    weight = 1.0 / (1.0 + np.exp(-local.STEEPNESS * (speed - local.BORDERS[-1])))
    lines = ["Table 6.1, 1750 rpm"]
    by_f = jnx.select(pool, train, local.method_of("F", 5, 3), weights=[weight])
    lines += ["partial F of the terms by iteration", f_table(by_f.stats["history"][0])]
    by_err = jnx.select(pool, train, local.method_of("ERR", 5, 3), weights=[weight])
    lines.append("ERR")
    value = by_err.value
    lines += [
        f"  {share:10.4g}  {name}"
        for share, name in zip(np.asarray(value.err)[0], value.names, strict=False)
    ]
    return "\n".join(lines)


def chapter6(smoke: bool, length: int) -> tuple[dict[str, Figure], str]:
    """Figures 6.8, 6.10 to 6.14 and 6.18 to 6.21, and Table 6.1."""
    found: dict[str, Figure] = {}
    benches = local.bench(SEED, length)
    budget = Budget(50, 20, 5, (10,)) if smoke else Budget()
    for (output, data), number in zip(benches.items(), ("11_12", "13_14"), strict=True):
        seen = data[1:2]
        network = local.network_of(data, "local linear", local.method_of("F", 5, 1))
        if output == TORQUE:
            (entry,) = describe_partition(network).values()
            found["6_08"] = partition(entry)
            found["6_10"] = channels(seen)
        pool = local.pool_of(data, 1, local.EVERY)
        given = {"width": local.WIDTHS[0], "key": jax.random.key(SEED)}
        neural = train(pool, data[:1], validation=seen, budget=budget, **given)["NOE"]
        runs = {
            "local models": free_run(network, seen),
            "perceptron": neural_run(neural, seen, one_step=False).outputs[0][:, 0],
        }
        found[f"6_{number}"] = estimates(seen, runs)
    measured = records(PfiDyno(), jax.random.key(SEED), [length] * 3, names=PARTS)
    data = chosen(measured, lolimot.INPUTS, lolimot.OUTPUT, lolimot.BED)
    grown = [
        lolimot.grown(data, lolimot.REFINED, models) for models in range(2, GROWN + 1)
    ]
    found["6_18"] = channels(data)
    found["6_19"] = partitions(grown)
    found["6_20"] = curves(grown[-1])
    two = free_run(grown[lolimot.THESIS - 2], data[1:2])
    found["6_21"] = estimates(data[1:2], {"two local models": two})
    return found, table_6_1(benches[TORQUE])


def chapter7(length: int) -> dict[str, Figure]:
    """Figures 7.1 to 7.5."""
    benches = forward.bench(SEED, length)
    found = {"7_01": channels(benches[TORQUE])}
    found["7_02"] = gate(forward.BORDERS[0], forward.STEEPNESS[0], forward.SPEEDS)
    for output, how, number in (("AFR", "ERR", "4"), (TORQUE, "F", "5")):
        data = benches[output]
        network = forward.network_of(data, forward.AXIS, how, forward.REGIONS)
        (entry,) = describe_partition(network, data=data[:1]).values()
        found[f"7_03_{output}"] = partition(entry)
        name = f"three regions, {how}"
        run = {name: free_run(network, data[1:2])}
        found[f"7_0{number}"] = estimates(data[1:2], run)
    return found


def main() -> None:
    options = parsed(__doc__ or "", "short records, a hasty perceptron")
    jax.config.update("jax_enable_x64", True)
    smoke = options.smoke
    found = {"5_05": channels(miso.bench(SEED, 300 if smoke else miso.LENGTH)[TORQUE])}
    more, table = chapter6(smoke, 300 if smoke else local.LENGTH)
    found |= more | chapter7(400 if smoke else forward.LENGTH)
    for number, figure in found.items():
        save(figure, options.results / f"figure_{number}.png")
    print(table)


if __name__ == "__main__":
    main()
