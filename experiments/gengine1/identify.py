"""Eight outputs of a measured gasoline engine, by `jaxnarx identify` without a flag.

    python experiments/gengine1/identify.py [--presets good quick ecu] [--runs DIR]

Everything is chosen on the training records. The six test records are scored when a
search has ended, and every scoring is kept in the results with its date and commit. A
search goes on in its folder; one that is complete is only scored.

Beside it stand boosted trees on input histories up to 12.8 s (up to 400 trees an
output, 16 MB) and an LSTM of 64 units (42,500 parameters), measured for this project,
and the best that scripts of this folder had reached by hand before there was a search,
by several rules and with test records seen. A tenth of a percent of the samples of PN,
spikes of two records, carries most of its squared error.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxnarx as jnx
from jaxnarx.data import thin_records

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))
from common import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    ROOT,
    code,
    record,
    results_folder,
)

DESCRIPTION = Path(__file__).with_name("gengine1.toml")
NAMES = ("PN", "CO", "CO2", "HC", "NOx", "O2", "T_exhaust", "T_catalyst")
REFERENCES = {
    "trees": (0.877, 0.180, 0.088, 0.627, 0.097, 0.289, 0.107, 0.108),
    "LSTM": (0.860, 0.177, 0.097, 0.687, 0.132, 0.297, 0.094, 0.106),
    "by hand": (0.658, 0.123, 0.091, 0.642, 0.092, 0.305, 0.066, 0.111),
}
"""RMSE pooled over the test records."""
AIM = 0.215
"""Mean NRMSE over the outputs that the search shall reach."""
ONE_STEP_SAMPLES = 6_000
"""Test samples whose one-step prediction is judged."""
NEAR = 1.03
"""Multiple of the figure reached by hand that counts as no worse."""


def shown(event: dict[str, Any]) -> None:
    """A candidate."""
    row = event.get("row")
    if row is not None:
        error = row.status if row.free_run is None else f"{row.free_run:.4f}"
        print(
            f"{event['seconds']:6.0f} s  {row.output} {row.family}: {error}", flush=True
        )


def errors(network: jnx.Network, data: jnx.Dataset) -> dict[str, dict[str, Any]]:
    """One step and free run by output, pooled over the records; one step on stretches
    of them, as hidden states are estimated anew for every sample of it."""
    some = thin_records(data, ONE_STEP_SAMPLES)
    runs = {
        "one_step": (some, jnx.predict(network, some)),
        "free_run": (data, jnx.simulate(network, data)),
    }
    out: dict[str, dict[str, Any]] = {name: {} for name in network.output_names}
    for mode, (records, run) in runs.items():
        for k, (o, name) in enumerate(
            zip(network.modelled, network.output_names, strict=True)
        ):
            parts = zip(records, run.value.outputs, run.value.scored, strict=True)
            pairs = [(r.y[:, o][s[:, k]], y[:, k][s[:, k]]) for r, y, s in parts]
            y, yhat = (np.concatenate(part) for part in zip(*pairs, strict=True))
            rmse = float(np.sqrt(np.mean((y - yhat) ** 2)))
            out[name][mode] = {"rmse": rmse, "nrmse": rmse / float(y.std())}
        bad = [d for d in run.value.diverged]
        for k, name in enumerate(network.output_names):
            out[name][mode]["diverged"] = int(sum(d[k] for d in bad))
    return out


def row_of(fit: Any, name: str, scores: dict[str, Any]) -> dict[str, Any]:
    """What was chosen for an output, what it promised, and what came."""
    board = fit.stats["leaderboard"]
    chosen, best = board.choose(name), board.best(name)
    place = NAMES.index(name)
    beside = {kind: values[place] for kind, values in REFERENCES.items()}
    linear = [r for r in board.of(name) if r.family == "OE" and r.eligible]
    return {
        "output": name,
        "chosen": f"{chosen.family}: {chosen.name}",
        "cross_validated": {
            "chosen": chosen.free_run,
            "standard_error": chosen.standard_error,
            "best": best.free_run,
            "nested": chosen.nested,
            "linear OE": linear[0].free_run if linear else None,
        },
        "seconds": round(sum(r.seconds for r in board.of(name)), 1),
        "operations": chosen.operations,
        "parameters": chosen.parameters,
        "test": scores,
        "beside": beside,
        "within 1.03 of by hand": scores["free_run"]["rmse"]
        <= NEAR * beside["by hand"],
    }


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Mean NRMSE beside the references' by the same scale, and what diverged."""
    scale = [
        r["test"]["free_run"]["nrmse"] / r["test"]["free_run"]["rmse"] for r in rows
    ]
    means = {
        kind: float(
            np.mean([r["beside"][kind] * s for r, s in zip(rows, scale, strict=True)])
        )
        for kind in REFERENCES
    }
    ours = float(np.mean([r["test"]["free_run"]["nrmse"] for r in rows]))
    return {
        "mean NRMSE": {"jaxnarx": ours, **means},
        "aim": {"value": ours, "limit": AIM, "met": ours <= AIM},
        "diverged": sum(r["test"]["free_run"]["diverged"] for r in rows),
        "outputs within 1.03 of by hand": sum(
            r["within 1.03 of by hand"] for r in rows
        ),
    }


def show(preset: str, rows: Sequence[dict[str, Any]]) -> None:
    """A table."""
    print(f"\n{preset}: RMSE on the test records")
    for r in rows:
        one, free = (r["test"][m]["rmse"] for m in ("one_step", "free_run"))
        beside = "  ".join(f"{k} {v:.3f}" for k, v in r["beside"].items())
        print(f"{r['output']:10s} {one:.4f} {free:.4f}  [{beside}]  {r['chosen']}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Search, score, record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", nargs="+", default=["good", "quick", "ecu"])
    parser.add_argument("--runs", type=Path, default=ROOT / "runs", metavar="DIR")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="one output, few samples")
    options = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    split = jnx.read_split(DESCRIPTION)
    assert split.train is not None and split.test is not None
    train, test, presets = split.train, split.test, options.presets
    if options.smoke:
        train, test, presets = small(train[:4]), small(train[4:5]), ["linear"]
    folder = results_folder(options.results, smoke=options.smoke)
    path = folder / "gengine1_identify.json"
    figures = json.loads(path.read_text())["figures"] if path.exists() else {}
    for preset in presets:
        place = options.runs / f"gengine1-{preset}"
        began = search_began(place)
        fit = jnx.identify(train, preset=preset, folder=place, progress=shown)
        scores = errors(fit.value, test)
        rows = [row_of(fit, name, scores[name]) for name in fit.value.output_names]
        past = figures.get(preset, {}).get("scored", [])
        told = {"mean NRMSE": summary(rows)["mean NRMSE"]["jaxnarx"]}
        figures[preset] = {
            "summary": summary(rows),
            "rows": rows,
            "scored": [*past, code() | {"date": time.strftime("%Y-%m-%d")} | told],
            "search began": began,
        }
        show(preset, rows)
        print(summary(rows))
        record("gengine1_identify", figures, folder=folder)


def search_began(folder: Path) -> dict[str, Any]:
    """The code a search began with: one that goes on later may end with another."""
    path = folder / "began.json"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(code()))
    return json.loads(path.read_text())


def small(data: jnx.Dataset) -> jnx.Dataset:
    """Two outputs and a thousand samples of every record."""
    return jnx.Dataset.from_arrays(
        [r.u[:1000] for r in data],
        [r.y[:1000, 6:7] for r in data],
        inputs=data.channels.input_names,
        outputs=[data.channels.output_names[6]],
        sample_time=data.sample_time,
        names=data.names,
    )


if __name__ == "__main__":
    main()
