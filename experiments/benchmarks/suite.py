"""What the tests cost: time, core seconds, memory and programs, from a fresh clone.

    python experiments/benchmarks/suite.py default|run|full [--note TEXT]

`default` are the tests of the README's second command, without the time of setting up;
`run` is what every landing must pass, `full` is everything. Nothing is cached: the last
commit is cloned, and what was compiled before is not found. Two cores that do nothing
else are meant. Results go to `suite_PART.json`.
"""

import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from common import ROOT, benchmark_parser, record, results_folder, target

LIMITS = {"default": 300.0, "run": 720.0, "full": 2700.0}
MEMORY = 3.0
"""Aims: seconds of each part, and GB of a process."""


def cost(part: str, space: Path) -> dict[str, Any]:
    """Run one part in a clone below `space`."""
    home = space / "clone"
    subprocess.run(["git", "clone", "-q", str(ROOT), str(home)], check=True)
    data = os.environ.get("JAXNARX_DATA", str(ROOT / "../shared/data"))
    environment = os.environ | {
        "XDG_CACHE_HOME": str(space / "cache"),
        "JAXNARX_DATA": str(Path(data).resolve()),
    }
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    command = [str(home / ".ci" / part)]
    if part == "default":
        python = home / ".venv" / "bin" / "python"
        subprocess.run([sys.executable, "-m", "venv", str(home / ".venv")], check=True)
        install = [str(python), "-m", "pip", "install", "-q", "-e", ".[tests]"]
        subprocess.run(install, cwd=home, check=True)
        command = [str(python), "-m", "pytest", "-q", "-n", "auto"]
    before, start = _children(), time.monotonic()
    done = subprocess.run(
        command, cwd=home, env=environment, stdout=subprocess.PIPE, text=True
    )
    seconds, after = time.monotonic() - start, _children()
    print(done.stdout[-4000:])
    tests = [int(n) for n in re.findall(r"\b(\d+) passed", done.stdout)]
    programs = [int(n) for n in re.findall(r"^(\d+) programs", done.stdout, re.M)]
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9
    return {
        "exit_code": done.returncode,
        "seconds": target(round(seconds, 1), LIMITS[part]),
        "core_seconds": round(after - before),
        "largest_process_gb": target(round(memory, 2), MEMORY),
        "passed": tests,
        "programs": programs,
        "steps": re.findall(r"^== (.*) \((\d+)s\)$", done.stdout, re.M),
    }


def _children() -> float:
    """Core seconds of all processes that have ended below this one."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main() -> int:
    """Run and record."""
    parser = benchmark_parser("What the tests cost.", "nothing: the parts are whole")
    parser.add_argument("part", choices=LIMITS)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as space:
        figures = cost(chosen.part, Path(space))
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    record(f"suite_{chosen.part}", figures, folder=folder, note=chosen.note)
    return figures["exit_code"]


if __name__ == "__main__":
    sys.exit(main())
