"""A measured engine's NOx model for a control unit: what its export takes.

`jnx.identify` with the preset ecu on the training records of gengine1, NOx alone; then
every target, proven over all 26 records beside the model. No test record is scored: the
figures are of exported and model, not of model and engine.

    python experiments/gengine1/export.py [--smoke]

Results: `experiments/benchmarks/results/gengine1_export.json`.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
from common import record, results_folder  # noqa: E402 # pyright: ignore

DESCRIPTION = HERE / "gengine1.toml"
OUTPUT = "NOx"


def main() -> None:
    """Identify, export, record."""
    import jax

    import jaxnarx as jnx

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="few samples")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    split = jnx.read_split(DESCRIPTION)
    assert split.train is not None
    train, every, preset, most = split.train, split.all, "ecu", None
    if options.smoke:
        train, every = shortened(train[:4]), shortened(split.all[:2])
        preset, most = "linear", 3
    fit = jnx.identify(train, preset=preset, outputs=[OUTPUT], candidates=most)
    row = fit.stats["leaderboard"].choose(OUTPUT)
    from jaxnarx.exporters import TARGETS

    figures: dict[str, Any] = {
        "chosen": f"{row.family}: {row.name}",
        "left out": row.free_run,
        "records": len(every),
        "samples": sum(len(r) for r in every),
    }
    kinds: tuple[tuple[str, dict[str, Any]], ...] = (
        ("with its index", {}),
        ("with index and intervals", {"level": 0.9}),
        ("alone", {"index": False}),
    )
    for kind, asked in kinds:
        to = list(TARGETS) if kind == "alone" else ["c"]
        found = jnx.export(fit.value, every, to=to, name=OUTPUT, **asked)
        figures[kind] = {
            "operations": found.operations,
            "bytes of tables": 8 * found.parameters,
            "bytes of tables, single": 4 * found.parameters,
            "numbers kept": found.kept,
            "difference": dict(found.difference),
            "left out": list(found.left_out),
            "object code": code_bytes(found),
            "packed": {k: len(v) for k, v in found.files.items() if k.endswith("fmu")},
        }
        print(kind, figures[kind], flush=True)
    folder = results_folder(options.results, smoke=options.smoke)
    record("gengine1_export", figures, folder=folder)


def shortened(data: Any) -> Any:
    """A thousand samples of every record."""
    import dataclasses

    short = [
        dataclasses.replace(r, u=r.u[:1000], y=r.y[:1000], valid=r.valid[:1000])
        for r in data.records
    ]
    return dataclasses.replace(data, records=tuple(short))


def code_bytes(found: Any) -> dict[str, int]:
    """Text and read-only data of the compiled step, in both precisions."""
    import subprocess

    from jaxnarx.exporters.compilers import compilers

    sizes = {}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, text in found.texts.items():
            (folder / name).write_text(text)
        for kind in ("double", "single"):
            define = [f"-D{OUTPUT.upper()}_SINGLE"] if kind == "single" else []
            for cc in compilers()[:1]:
                command = [cc, "-std=c99", "-Os", *define, "-c", f"{OUTPUT}.c"]
                subprocess.run(command, cwd=folder, check=True)
                told = subprocess.check_output(["size", f"{OUTPUT}.o"], cwd=folder)
                sizes[kind] = int(told.split()[6])
    return sizes


if __name__ == "__main__":
    main()
