"""The command line as a user runs it: wall time, peak memory, and figures of the fit.

Every command runs in a fresh process, first with an empty cache folder ("cold":
programs are compiled and matplotlib lists the fonts), then again ("warm"). The
gengine1 commands need its records (JAXNARX_DATA) and are skipped without.

    python experiments/benchmarks/identify.py
    python experiments/benchmarks/identify.py --only start demo
"""

import argparse
import json
import os
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

from common import Child, child, record, results_folder, target

DESCRIPTION = "experiments/gengine1/gengine1.toml"

SCHEDULE = ("--schedule", "speed[t]", "load[t]")
CUBIC = ("--output", "NOx", "--degree", "3", "--terms", "25")
TWELVE = ("--output", "T_exhaust", "--degree", "1", "--terms", "12", "--models", "6")
SECONDS, MEGABYTES = 120.0, 4000.0
"""Targets of the cubic run, which reads 248,000 samples and refines on full records."""

DEMO_SECONDS, IMPORT_SECONDS, HELP_SECONDS = 60.0, 3.0, 0.5
STARTS = {
    "python": (None, ("-c", "pass")),
    "import jaxnarx": (IMPORT_SECONDS, ("-c", "import jaxnarx")),
    "jaxnarx.select": (IMPORT_SECONDS, ("-c", "import jaxnarx; jaxnarx.select")),
    "jaxnarx --help": (HELP_SECONDS, ("--help",)),
    "jaxnarx identify --help": (HELP_SECONDS, ("identify", "--help")),
}
SMOKE_DEMO = ("--events", "400", "--models", "2")
PARTS = ("start", "demo", "gengine1")


class Failure(Exception):
    """A command did not end well; the message holds the end of what it said."""


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description="Benchmarks of the command line.")
    parser.add_argument("--smoke", action="store_true", help="a short demo, no data")
    parser.add_argument("--only", nargs="+", choices=PARTS, help="default: all")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--note", default="", help="a remark kept with the figures")
    chosen = parser.parse_args()
    parts = chosen.only or (PARTS[:2] if chosen.smoke else PARTS)
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    repeats = 1 if chosen.smoke else 5
    failed = []
    with tempfile.TemporaryDirectory() as temporary:
        space = Path(temporary)
        for part in parts:
            if part == "start":
                figures = {"runs": repeats, **start_times(repeats)}
            elif part == "demo":
                figures = demo(space, SMOKE_DEMO if chosen.smoke else ())
            else:
                figures = gengine1(space)
            print(record(part, figures, folder=folder, note=chosen.note))
            _show(figures)
            failed += [run for run in figures.values() if _has_failed(run)]
    return 1 if failed else 0


def jaxnarx(*arguments: str, cache: Path | None = None) -> Child:
    """One command, with its caches under `cache`."""
    script = Path(sys.executable).with_name("jaxnarx")
    command = [str(script)]
    if not script.exists():
        command = [sys.executable, "-m", "jaxnarx.shell.cli"]
    environment = {} if cache is None else {"XDG_CACHE_HOME": str(cache)}
    done = child([*command, *arguments], environment=environment)
    if done.code != 0:
        raise Failure(f"jaxnarx {' '.join(arguments)}: {done.stderr.strip()[-500:]}")
    return done


def start_times(repeats: int) -> dict[str, Any]:
    """Median wall time of imports and help texts, and of the interpreter alone."""
    figures: dict[str, Any] = {}
    for name, (limit, arguments) in STARTS.items():
        walls = []
        for _ in range(repeats + 1):
            if arguments[0] == "-c":
                walls.append(child([sys.executable, *arguments]).wall)
            else:
                walls.append(jaxnarx(*arguments).wall)
        # The first reads the files from disk, and may still write byte code.
        median = round(statistics.median(walls[1:]), 3)
        figures[name] = {"first_s": round(walls[0], 3), "median_s": median}
        if limit is not None:
            figures[name]["target_s"] = target(median, limit)
    return figures


def demo(space: Path, options: tuple[str, ...]) -> dict[str, Any]:
    """`jaxnarx demo` with empty and with filled caches."""
    run = _twice(space / "demo", "speed", "demo", *options)
    if not _has_failed(run):
        run["targets"] = {"warm_s": target(run["warm"]["wall_s"], DEMO_SECONDS)}
    return {"jaxnarx demo": run}


def jobs() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Output and options of every gengine1 command.

    "twelve terms" is what was first published; its settings were picked by somebody who
    had seen errors on the test records.
    """
    twelve = "T_exhaust", (*TWELVE, *SCHEDULE)
    return {"cubic NOx": ("NOx", CUBIC), "twelve terms T_exhaust": twelve}


def gengine1(space: Path) -> dict[str, Any]:
    """The measured engine: a cubic and local models."""
    root = os.environ.get("JAXNARX_DATA")
    if root is None or not (Path(root) / "gengine1").is_dir():
        return {"skipped": "JAXNARX_DATA does not hold gengine1"}
    figures = {}
    for name, (output, options) in jobs().items():
        run = _twice(space / name, output, "identify", DESCRIPTION, *options)
        if _has_failed(run):
            pass
        elif name == "cubic NOx":
            run["targets"] = {
                "cold_s": target(run["cold"]["wall_s"], SECONDS),
                "warm_s": target(run["warm"]["wall_s"], SECONDS),
                "peak_mb": target(run["cold"]["peak_mb"], MEGABYTES),
            }
        figures[name] = run
    return figures


def _has_failed(run: Any) -> bool:
    return isinstance(run, dict) and "failed" in run


def _twice(space: Path, output: str, *arguments: str) -> dict[str, Any]:
    """What `_measure` finds, or what a failed command said."""
    try:
        return _measure(space, output, *arguments)
    except Failure as failure:
        return {"failed": str(failure)}


def _measure(space: Path, output: str, *arguments: str) -> dict[str, Any]:
    """A command cold and warm, its figures, and those of its one-step model.

    The demo cannot leave out its refinement; it has no one-step model to show.
    """
    cache = space / "cache"
    cold = jaxnarx(*arguments, "--out", str(space / "cold"), cache=cache)
    warm = jaxnarx(*arguments, "--out", str(space / "warm"), cache=cache)
    reports = {"refined": _report(space / "warm")}
    if arguments[0] == "identify":
        start = [*arguments, "--steps", "0", "--out", str(space / "start")]
        jaxnarx(*start, cache=cache)
        reports = {"one-step model": _report(space / "start"), **reports}
    refined = reports["refined"]
    figures: dict[str, Any] = {
        "command": " ".join(["jaxnarx", *(_quoted(a) for a in arguments)]),
        "cold": cold.measured,
        "warm": warm.measured,
        "warm_repeats_cold": _report(space / "cold")["rows"] == refined["rows"],
        "data": {
            key: text.partition(", sha256")[0]
            for key, text in refined["provenance"].items()
            if key.endswith(" data")
        },
        "part": refined["main"],
        "output": output,
        "refinement_steps": _steps(refined),
        "refinement": refined["provenance"]["refinement"],
    }
    for mode in ("one step", "free run"):
        figures[mode.replace(" ", "_")] = {
            model: _scores(report, output, mode) for model, report in reports.items()
        }
    return figures


def _quoted(argument: str) -> str:
    return f'"{argument}"' if "[" in argument else argument


def _report(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


def _steps(report: dict[str, Any]) -> dict[str, int]:
    """Refinement steps by stage, the full record among them."""
    stages = [row["stage"] for row in report["history"]]
    return {stage: stages.count(stage) for stage in dict.fromkeys(stages)}


def _scores(report: dict[str, Any], output: str, mode: str) -> dict[str, Any]:
    """RMSE, fit and status of the main part: pooled first, then record by record.

    A diverged record has no figure; the pooled row then says how many diverged, and
    `others` holds the figures of the rest.
    """
    kept = ("rmse", "fit", "samples", "limited", "extrapolated", "status", "others")
    rows = [
        row
        for row in report["rows"]
        if (row["part"], row["output"], row["mode"]) == (report["main"], output, mode)
    ]
    return {row["record"]: {key: row[key] for key in kept} for row in rows}


def _show(figures: dict[str, Any]) -> None:
    if "skipped" in figures:
        print(f"  skipped: {figures['skipped']}")
    for name, run in figures.items():
        if not isinstance(run, dict):
            continue
        if "failed" in run:
            print(f"  {name}: {run['failed']}")
            continue
        if "median_s" in run:
            print(f"  {name:24s}{run['median_s']:8.3f} s")
            continue
        print(
            f"  {name:24s}cold {run['cold']['wall_s']:.1f} s, warm "
            f"{run['warm']['wall_s']:.1f} s, {run['cold']['peak_mb']} MB"
        )
        for model, rows in run["free_run"].items():
            row = rows["pooled"]
            one = run["one_step"][model]["pooled"]
            print(
                f"    {model:16s}RMSE one step {_number(one)}, free run {_number(row)}"
            )


def _number(row: dict[str, Any]) -> str:
    return row["status"] if row["rmse"] is None else f"{row['rmse']:.4g}"


if __name__ == "__main__":
    sys.exit(main())
