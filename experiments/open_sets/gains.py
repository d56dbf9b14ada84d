"""What a kind of candidate gains: promised on groups left out, and on records not seen.

Of every output the best candidate of the kind and the best of all others, both trained
on all training records, are run freely over the test records.

- `sum`: `identify` with its preset `best` ends with the mean of up to three candidates,
  each the best of its kind, where the error of groups left out falls by more than 3 %.
- `hidden states`: with more than two inputs they are tried where they are asked for;
  here with two hidden states. Of the turbocharged engine turbo speed and manifold
  pressure are hidden to the torque, of the measured one wall temperatures to those of
  exhaust and catalyst.

    python experiments/open_sets/gains.py sum [--sets engine-gtdi gengine1]
    python experiments/open_sets/gains.py "hidden states" --sets gengine1

Virtual engines have records of their own for the test. Those of `gengine1` are its six
test records, and each scoring is one more of them (`gengine1_identify.json` counts the
others). Results: `experiments/benchmarks/results/gains.json`; outputs that are there
stay unless they are named.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
sys.path.insert(0, str(HERE.parent / "gengine1"))
sys.path.insert(0, str(HERE))
from common import ROOT, code, record, results_folder  # noqa: E402 # pyright: ignore

SETS = "engine-gtdi", "engine-vct", "engine-pfi"
MEASURED = "gengine1"
KINDS: dict[str, dict[str, Any]] = {
    "sum": {"preset": "best"},
    "hidden states": {"preset": "good", "states": 2},
}
"""What `identify` is asked for."""
SMALL = {"preset": "quick", "states": 1}
"""What a smoke run asks for in place of hidden states."""


def records(name: str, *, small: bool) -> tuple[Any, Any]:
    """Training and test records of a set."""
    import jaxnarx as jnx

    if name == MEASURED:
        from identify import DESCRIPTION  # pyright: ignore[reportMissingImports]

        split = jnx.read_split(DESCRIPTION)
        return split.train, split.test
    from own import load  # pyright: ignore[reportMissingImports]

    found = load(name, os.environ.get("JAXNARX_DATA", "../shared/data"), small=small)
    part, *_ = found.parts.values()  # the one with noise
    return found.train, part.data


def nrmse(network: Any, data: Any) -> tuple[float, int]:
    """Of the free run, pooled over the records, and how many diverge."""
    import numpy as np

    import jaxnarx as jnx
    from jaxnarx.data import match_channels

    data = match_channels(data, network.channels.measured)[0]
    run = jnx.simulate(network, data).value
    (o,) = network.modelled
    parts = zip(data, run.outputs, run.scored, strict=True)
    pairs = [(r.y[:, o][s[:, 0]], y[:, 0][s[:, 0]]) for r, y, s in parts]
    y, yhat = (np.concatenate(part) for part in zip(*pairs, strict=True))
    error = float(np.sqrt(np.mean((y - yhat) ** 2)) / y.std())
    return error, int(sum(d[0] for d in run.diverged))


def told(event: dict[str, Any]) -> None:
    """A line for every candidate."""
    if "row" in event:
        row = event["row"]
        print(f"{event['seconds']:6.0f} s {row.output}: {row.family}", flush=True)


def compared(name: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for every output of a set."""
    import jaxnarx as jnx
    from jaxnarx.identification import read_search

    train, test = records(name, small=options.smoke)
    known = train.channels
    outputs = options.outputs or known.output_names
    outputs = outputs[:1] if options.smoke else outputs
    kind = options.kind
    folder = options.runs / "-".join((*kind.split(), name, *options.outputs))
    asked = KINDS[kind] if kind == "sum" or not options.smoke else SMALL
    pairs = -(-len(outputs) // min(len(outputs), 2))
    fit = jnx.identify(
        train,
        **asked,
        outputs=outputs,
        budget=60 * options.minutes * pairs,
        folder=folder,
        candidates=options.candidates,
        progress=told,
    )
    board, store, rows = fit.stats["leaderboard"], read_search(folder), []
    for output in outputs:
        every = [r for r in board.of(output) if r.eligible]
        added = next((r for r in every if r.family == kind), None)
        alone = next((r for r in every if r.family != kind), None)
        row: dict[str, Any] = {"output": output, "candidates": len(board.of(output))}
        for title, one in {"others": alone, "kind": added}.items():
            if one is None:
                continue
            network = store.network(one.number)
            error, diverged = nrmse(network, test)
            row[title] = {
                "name": f"{one.family}: {one.name}",
                "left out": one.free_run,
                "standard error": one.standard_error,
                "test": error,
                "diverged": diverged,
                "operations": one.operations,
                "parameters": one.parameters,
            }
        if added is not None and alone is not None:
            row["promised"] = added.free_run / alone.free_run
            row["kept"] = row["kind"]["test"] / row["others"]["test"]
        print(row, flush=True)
        rows.append(row)
    return rows


def main() -> None:
    """Search, score, record."""
    import jax

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", nargs="?", choices=KINDS, default="sum")
    parser.add_argument("--sets", nargs="+", choices=(*SETS, MEASURED), default=SETS)
    parser.add_argument("--outputs", nargs="+", default=[], help="default: all")
    parser.add_argument("--minutes", type=float, default=2.5, help="for an output")
    parser.add_argument("--candidates", type=int, help="most of an output")
    parser.add_argument("--runs", type=Path, default=ROOT / "runs", metavar="DIR")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="one output, few samples")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    folder = results_folder(options.results, smoke=options.smoke)
    path = folder / "gains.json"
    figures = json.loads(path.read_text())["figures"] if path.exists() else {}
    for name in SETS[:1] if options.smoke else options.sets:
        rows = compared(name, options)
        past = figures.setdefault(options.kind, {}).get(
            name, {"rows": [], "scored": []}
        )
        named = [row["output"] for row in rows]
        rows = [r for r in past["rows"] if r["output"] not in named] + rows
        now = code() | {"date": time.strftime("%Y-%m-%d"), "outputs": named}
        scored = [*past["scored"], now | {"minutes": options.minutes}]
        figures[options.kind][name] = {"rows": rows, "scored": scored}
        record("gains", figures, folder=folder)


if __name__ == "__main__":
    main()
