"""Programs that XLA makes, counted, with a budget for every test file.

Compiling and lowering are most of the time of the tests, so that a file that asks for
new shapes or settings is told at once. A budget is what the file makes in a process of
its own; beside others it makes less.

    python tests/programs.py [FILE ...]

measures the files, all by default, and records their budgets.
"""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

from jax import monitoring

ROOT = Path(__file__).resolve().parents[1]
BUDGETS = ROOT / "tests" / "reference" / "programs.json"
LEAST = 8
"""What a file may make of which nothing is recorded, and more than its record."""

_made: list[float] = []


def _count(event: str, duration_secs: float, **kwargs: str | int) -> None:
    del kwargs
    if event == "/jax/core/compile/backend_compile_duration":
        _made.append(duration_secs)


monitoring.register_event_duration_secs_listener(_count)


def made() -> int:
    """Programs of this process so far, loaded ones among them."""
    return len(_made)


def budget(file: str) -> float:
    """What a test file may make; without bound while budgets are measured."""
    if os.environ.get("JAXNARX_PROGRAMS") == "unbounded" or not BUDGETS.exists():
        return float("inf")
    return json.loads(BUDGETS.read_text()).get(file, 0) + LEAST


def effort() -> tuple[float, float]:
    """Core seconds of this process with its children, and its own peak memory [GB]."""
    own = resource.getrusage(resource.RUSAGE_SELF)
    others = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime
    return seconds, own.ru_maxrss * 1024 / 1e9


def lines(workers: list[dict]) -> list[str]:
    """What a run has cost: `files`, `seconds` and `memory` of every worker."""
    files = {k: v for worker in workers for k, v in worker["files"].items()}
    most = sorted(files.items(), key=lambda item: -item[1])[:5]
    return [
        f"{sum(files.values())} programs in {len(files)} files, "
        f"{sum(w['seconds'] for w in workers):.0f} core seconds, "
        f"largest process {max(w['memory'] for w in workers):.1f} GB",
        "most programs: " + ", ".join(f"{name} {number}" for name, number in most),
    ]


def measure(file: str) -> int | None:
    """Programs of one file alone; None where its tests fail."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", file]
    environment = os.environ | {"JAXNARX_PROGRAMS": "unbounded"}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True
    )
    found = [line for line in done.stdout.splitlines() if " programs in " in line]
    if done.returncode not in (0, 5) or not found:
        print(done.stdout[-2000:], file=sys.stderr)
        return None
    return int(found[0].split()[0])


def main() -> None:
    files = sys.argv[1:] or [
        str(path.relative_to(ROOT)) for path in sorted(ROOT.glob("tests/**/test_*.py"))
    ]
    known = json.loads(BUDGETS.read_text()) if BUDGETS.exists() else {}
    for file in files:
        number = measure(file)
        if number is not None:
            known[file] = number
        print(f"{file}: {number}", flush=True)
        there = {k: v for k, v in sorted(known.items()) if (ROOT / k).exists() and v}
        BUDGETS.write_text(json.dumps(there, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
