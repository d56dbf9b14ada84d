"""The four test beds that stand in for those of thesis chapter 3.

Simulates every bed under its usual excitation and draws inputs and outputs; compares
steady states with the reference tables of the beds' specification (`reference/`, the
figures as printed there); shows what makes the diesel worth a multi-model: closing the
turbine raises the air flow from 75 % and lowers it from 30 %, and opening the EGR valve
first raises and then lowers the intake pressure (non-minimum phase).

Run as `python experiments/thesis/chapter3_test_beds.py [--results DIR] [--smoke]`.
Writes chapter3_test_beds.json, steady.png, diesel_steps.png and one PNG for each bed.
"""

import argparse
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.figure
import numpy as np

from jaxnarx.engines import BEDS, AbstractEngine, Diesel, Drive, Gtdi, Pfi, Vct, records
from jaxnarx.engines.gtdi.state import GtdiDrive
from jaxnarx.engines.vct import VctDrive
from jaxnarx.shell.figures.excitation import excitation

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from common import record  # noqa: E402 # pyright: ignore[reportMissingImports]

SEED, SECONDS = 3, 60.0
REFERENCE = Path(__file__).with_name("reference")
STEP = 0.005  # s, of the diesel's responses
TOLERANCE = {"gtdi": 0.01}  # relative, of the specification; 0.005 elsewhere
FIRST_TURBO = 0.03  # of the gtdi's turbo speed in its first row


# steady states --------------------------------------------------------------------


def free(row) -> tuple[AbstractEngine, Drive]:
    return Pfi(), Drive(row["duty"])


def held(row) -> tuple[AbstractEngine, Drive]:
    return Pfi(), Drive(row["duty"], pulse=row["pulse"], speed=row["speed"])


def gtdi(row) -> tuple[AbstractEngine, GtdiDrive]:
    drive = GtdiDrive(row["THR"], row["rpm"], fuel=row["FUL"], spark=row["SA"])
    return Gtdi(), jax.tree.map(jnp.asarray, drive)


def vct(row) -> tuple[AbstractEngine, VctDrive]:
    return Vct(), VctDrive(row["throttle"], row["cam"], row["speed"], ratio=14.64)


def diesel(row) -> tuple[AbstractEngine, jax.Array]:
    names = ("fuel", "egr_valve", "vgt", "speed")
    return Diesel(), jnp.stack([row[name] for name in names])


TABLES = {
    "pfi_free": (free, ("duty",)),
    "pfi_held": (held, ("speed", "duty", "pulse")),
    "diesel": (diesel, ("speed", "fuel", "egr_valve", "vgt")),
    "gtdi": (gtdi, ("FUL", "SA", "THR", "rpm")),
    "vct": (vct, ("speed", "throttle", "cam")),
}
"""How a row of each table is set up, and which of its columns are given."""


def table(name: str) -> dict[str, list[str]]:
    """A reference table by column, entries as printed."""
    rows = (REFERENCE / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    header, *body = (line.split() for line in rows)
    return dict(zip(header, map(list, zip(*body, strict=True)), strict=True))


def found(name: str) -> dict[str, np.ndarray]:
    """What the bed gives at every row of a table."""
    prepare, _ = TABLES[name]
    columns = {k: jnp.asarray([float(x) for x in v]) for k, v in table(name).items()}

    @jax.jit
    @jax.vmap
    def settle(row):
        engine, drive = prepare(row)
        balance = getattr(engine, "balance", engine.steady_state)
        return engine.quantities(balance(drive), drive)._asdict()

    return {k: np.asarray(v) for k, v in settle(columns).items()}


def compared(name: str) -> dict[str, dict]:
    """By column: how far the worst entry is off, and whether all are within tolerance.

    Allowed is a share of the entry, or half a unit of its last printed digit.
    """
    entries, values, out = table(name), found(name), {}
    for column in [c for c in entries if c not in TABLES[name][1]]:
        printed = np.array([float(x) for x in entries[column]])
        digit = [0.5 * 10.0 ** -len(x.partition(".")[2]) for x in entries[column]]
        share = np.full(len(printed), TOLERANCE.get(name, 0.005))
        if (name, column) == ("gtdi", "turbo"):
            share[0] = FIRST_TURBO
        off = np.abs(values[column] - printed)
        allowed = np.maximum(share * np.abs(printed), digit)
        size = np.maximum(np.abs(printed), np.abs(printed).max() * 1e-3)
        out[column] = {
            "worst_percent": float(100 * np.max(off / size)),
            "within": bool(np.all(off <= allowed)),
        }
    return out


def draw_steady(rows: dict[str, dict[str, dict]]) -> matplotlib.figure.Figure:
    """The worst deviation of every column of every table."""
    figure = matplotlib.figure.Figure(figsize=(9, 6.4), layout="constrained")
    axes = figure.subplots(1, 1)
    flat = [(f"{t}: {c}", row) for t, cols in rows.items() for c, row in cols.items()]
    at = np.arange(len(flat))
    color = ["C0" if row["within"] else "C3" for _, row in flat]
    worst = [max(row["worst_percent"], 1e-4) for _, row in flat]
    axes.barh(at, worst, color=color, height=0.7)
    axes.set_yticks(at, [label for label, _ in flat], fontsize=6.5)
    axes.invert_yaxis()
    axes.margins(y=0.005)
    axes.set(
        xscale="log",
        xlabel="largest deviation from the printed table [%], rounding of its last "
        "digit included",
        title="blue: every entry within the tolerance of the specification",
    )
    axes.axvline(0.5, color="0.4", lw=0.8, ls="--")
    return figure


# the diesel's own difficulties ----------------------------------------------------

STEPS = {
    "VGT 75 to 65 %": ((110, 80, 75, 1500), (110, 80, 65, 1500)),
    "VGT 30 to 25 %": ((110, 80, 30, 1500), (110, 80, 25, 1500)),
    "EGR 0 to 50 %": ((110, 0, 50, 1500), (110, 50, 50, 1500)),
}


@eqx.filter_jit
def responses(before, after):
    """Quantities every `STEP` seconds after each step of the inputs, no dead times."""
    zero = jnp.asarray(0.0)
    engine = Diesel(egr_delay=zero, vgt_delay=zero, interval=STEP)

    def one(before, after):
        def sample(carry, _):
            now = engine.quantities(carry[0], after)
            return engine.advance(carry, after)[0], (now.compressor, now.pressure)

        return jax.lax.scan(sample, engine.rest(before), None, length=1200)[1]

    return jax.vmap(one)(before, after)


def diesel_steps() -> tuple[dict[str, dict], dict[str, np.ndarray]]:
    """Start, extreme and end of the three responses, and the responses."""
    ends = [jnp.asarray(side, float) for side in zip(*STEPS.values(), strict=True)]
    flow, pressure = map(np.asarray, responses(*ends))
    curves = dict(zip(STEPS, [flow[0], flow[1], pressure[2]], strict=True))
    figures = {}
    for name, y in curves.items():
        way = y[-1] - y[0]
        against = np.argmax(-np.sign(way) * (y - y[0]))
        beyond = np.argmax(np.sign(way) * (y - y[0]))
        at = beyond if name == "VGT 30 to 25 %" else against
        figures[name] = {
            "start": float(y[0]),
            "extreme": float(y[at]),
            "extreme_at_s": float(at * STEP),
            "end": float(y[-1]),
        }
    return figures, curves


def draw_diesel(curves: dict[str, np.ndarray], gain) -> matplotlib.figure.Figure:
    """Steady air flow over the turbine position, and the three responses."""
    figure = matplotlib.figure.Figure(figsize=(9, 5.6), layout="constrained")
    axes = figure.subplots(2, 2).ravel()
    position, flow = gain
    best = int(np.argmax(flow))
    axes[0].plot(position, flow)
    axes[0].plot(position[best], flow[best], "o", color="C3", ms=5)
    axes[0].annotate(
        f"gain changes sign at {position[best]:.0f} %",
        (position[best], flow[best]),
        xytext=(-30, -34),
        textcoords="offset points",
    )
    axes[0].set(
        xlabel="VGT position [%], 100 is open",
        ylabel="steady air flow W_c [kg/s]",
        title="1500 rpm, 110 mg, EGR valve 80 %",
    )
    units = ("air flow W_c [kg/s]",) * 2 + ("intake pressure [bar]",)
    for ax, (name, y), label in zip(axes[1:], curves.items(), units, strict=True):
        ax.plot(STEP * np.arange(len(y)), y)
        for level in (y[0], y[-1]):
            ax.axhline(level, color="0.6", lw=0.7, ls=":")
        ax.set(xlabel="time after the step [s]", ylabel=label, title=name)
    for ax in axes:
        ax.grid(visible=True, color="0.9", lw=0.6)
    return figure


@jax.jit
@jax.vmap
def steady_flow(position):
    """Air flow at rest."""
    row = jnp.stack([*map(jnp.asarray, (110.0, 80.0)), position, jnp.asarray(1500.0)])
    engine = Diesel()
    return engine.quantities(engine.steady_state(row), row).compressor


# records --------------------------------------------------------------------------


def bed_record(name: str, seconds: float) -> tuple[dict, matplotlib.figure.Figure]:
    """One record under the usual excitation: ranges, broken limits, and its figure."""
    engine = BEDS[name]()
    length = max(40, round(seconds / engine.sample_time))
    data = records(engine, jax.random.key(SEED), [length], names=[name])
    one = data.records[0]
    columns = np.concatenate([one.u, one.y], axis=1)
    spans = {
        c.label: [float(x.min()), float(x.max())]
        for c, x in zip(data.channels.all, columns.T, strict=True)
    }
    flags = {k: int(np.sum(v)) for k, v in engine.flags(one.u).items()}
    figures = {"samples": length, "ranges": spans, "samples_beyond_limit": flags}
    return figures, excitation(data, outputs=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="The four test beds.")
    parser.add_argument("--results", default=str(Path(__file__).with_name("results")))
    parser.add_argument("--smoke", action="store_true", help="one table, one short bed")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = Path(options.results)
    folder.mkdir(parents=True, exist_ok=True)
    tables = ["pfi_free"] if options.smoke else list(TABLES)
    beds = ["pfi"] if options.smoke else list(BEDS)
    steady = {name: compared(name) for name in tables}
    for name, columns in steady.items():
        worst = max(columns.values(), key=lambda row: row["worst_percent"])
        fine = all(row["within"] for row in columns.values())
        print(
            f"{name:9s} {len(columns):2d} columns, worst entry off by "
            f"{worst['worst_percent']:.3f} %: {'within' if fine else 'NOT within'} "
            "tolerance"
        )
    draw_steady(steady).savefig(folder / "steady.png", dpi=130)
    figures: dict = {"steady_states": steady, "beds": {}}
    if not options.smoke:
        position = np.linspace(20, 85, 66)
        flow = np.asarray(steady_flow(jnp.asarray(position)))
        figures["diesel_steps"], curves = diesel_steps()
        turn = float(position[np.argmax(flow)])
        figures["vgt_gain_changes_sign_at_percent"] = turn
        draw_diesel(curves, (position, flow)).savefig(
            folder / "diesel_steps.png", dpi=130
        )
    for name in beds:
        figures["beds"][name], drawn = bed_record(name, 6 if options.smoke else SECONDS)
        drawn.savefig(folder / f"{name}.png", dpi=110, facecolor="white")
        print(f"{name:9s} {figures['beds'][name]['samples']} samples")
    record("chapter3_test_beds", figures, folder=folder)


if __name__ == "__main__":
    main()
