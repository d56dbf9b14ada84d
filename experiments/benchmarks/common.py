"""What the benchmarks share: timing, memory, the machine, and results as JSON.

Only the standard library is imported here: the parent of a measured process must stay
small, see `child`.
"""

import argparse
import contextlib
import dataclasses
import importlib.metadata
import json
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
"""The repository."""

RESULTS = Path(__file__).resolve().parent / "results"

_FOLDERS = r"(?<![\w.~*/])~?/(?=[^\s/])(?:[^\s/'\":,]+/)*"
"""The folders of an absolute path, but not the bar in `GFLOP/s` or an address."""

PACKAGES = ("jax", "jaxlib", "numpy", "jaxnarx")


def record(
    name: str,
    figures: Mapping[str, Any],
    *,
    folder: Path = RESULTS,
    versions: Mapping[str, str] | None = None,
    note: str = "",
) -> Path:
    """Write `folder/name.json`, whole or not at all, and return its path.

    Beside `figures` it holds the machine (no host name), versions of Python and the
    packages (`versions` adds those of peers), the date, the commit of the code with a
    flag for uncommitted changes, and the command. Folders of this machine are stripped
    from every text.
    """
    content = {
        "benchmark": name,
        "note": note,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shown_command(),
        "code": code(),
        "machine": _machine(),
        "versions": _versions() | dict(versions or {}),
        "figures": figures,
    }
    text = json.dumps(portable(content), indent=1, allow_nan=False) + "\n"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)
    return path


def portable(value: Any) -> Any:
    """`value` with the folders of absolute paths cut from all its texts."""
    if isinstance(value, Mapping):
        return {key: portable(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [portable(item) for item in value]
    if isinstance(value, str):
        inside = value.replace(f"{ROOT}{os.sep}", "")
        return re.sub(_FOLDERS, "", inside)
    return value


def shown_command() -> str:
    """The command of this process, relative to the repository."""
    script = Path(sys.argv[0]).resolve()
    name = script.relative_to(ROOT) if script.is_relative_to(ROOT) else script.name
    arguments = [f'"{a}"' if " " in a else a for a in sys.argv[1:]]
    return " ".join(["python", Path(name).as_posix(), *arguments])


def code() -> dict[str, Any]:
    """Commit, and whether package, scripts or settings differ from it."""
    watched = ["jaxnarx", "pyproject.toml", "experiments/*.py", "experiments/*.toml"]
    commit = _git("rev-parse", "HEAD")
    changed = _git("status", "--porcelain", "--", *watched)
    return {"commit": commit, "dirty": None if changed is None else bool(changed)}


def _git(*arguments: str) -> str | None:
    command = ["git", "-C", str(ROOT), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def _machine() -> dict[str, Any]:
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "memory_gb": round(
            os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1
        ),
        "system": f"{platform.system()} {platform.machine()}",
        "load_at_end": [round(x, 2) for x in os.getloadavg()],
    }


def _cpu() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[package] = importlib.metadata.version(package)
    return found


def best_of(
    function: Callable[[], Any], repeats: int, *, warm_up: int = 1
) -> dict[str, Any]:
    """Wall time [s] of `function` after `warm_up` calls that do not count."""
    for _ in range(warm_up):
        function()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return {
        "best": float(f"{min(times):.4g}"),
        "median": float(f"{statistics.median(times):.4g}"),
        "repeats": repeats,
    }


def target(value: float | None, limit: float) -> dict[str, Any]:
    """A figure beside the limit it should stay within, and whether it does."""
    return {"value": value, "limit": limit, "met": value is not None and value <= limit}


def matmul_rate(size: int = 2048) -> dict[str, float]:
    """Rate of square float64 matrix products in this process [GFLOP/s].

    Of jax, which the package uses, and of numpy, which may have the faster library.
    """
    import jax
    import jax.numpy as jnp
    import numpy as np

    x = np.random.default_rng(0).standard_normal((size, size))
    device = jnp.asarray(x)
    assert device.dtype == np.float64, "the rate is meant in float64"
    product = jax.jit(jnp.matmul)
    rates = {}
    for name, call in (
        ("jax", lambda: jax.block_until_ready(product(device, device))),
        ("numpy", lambda: x @ x),
    ):
        rates[name] = round(2e-9 * size**3 / best_of(call, 5)["best"], 1)
    return rates


def resident() -> tuple[int, int]:
    """Memory of this process now, and its peak [bytes]; Linux only."""
    text = Path("/proc/self/status").read_text()
    found = dict(re.findall(r"^(VmRSS|VmHWM):\s+(\d+) kB$", text, re.MULTILINE))
    return int(found["VmRSS"]) * 1024, int(found["VmHWM"]) * 1024


def available_memory() -> int:
    """Memory that could be taken now without swapping [bytes]; Linux only."""
    text = Path("/proc/meminfo").read_text()
    found = re.search(r"^MemAvailable:\s+(\d+) kB$", text, re.MULTILINE)
    return int(found[1]) * 1024 if found else 0


@dataclasses.dataclass(frozen=True)
class Child:
    """How a child process ended: wall time [s], peak memory [bytes], exit code."""

    wall: float
    peak: int
    code: int
    stdout: str
    stderr: str

    @property
    def measured(self) -> dict[str, Any]:
        """Wall time and peak memory, rounded for the record."""
        return {
            "wall_s": round(self.wall, 3),
            "peak_mb": round(self.peak / 1e6),
            "exit_code": self.code,
        }


def child(
    arguments: Sequence[str],
    *,
    environment: Mapping[str, str] | None = None,
    limit: float = 3600.0,
    cwd: Path = ROOT,
) -> Child:
    """Run a process to its end, or kill it after `limit` seconds, and measure it.

    The peak is that of the process itself. Linux starts its count at the size of the
    parent, so the parent must be small: that is why scripts import jax only in workers.
    """
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        begin = time.perf_counter()
        process = subprocess.Popen(
            arguments, stdout=out, stderr=err, cwd=cwd, env=_environment(environment)
        )
        killer = threading.Timer(limit, process.kill)
        killer.start()
        try:
            _, status, usage = os.wait4(process.pid, 0)
        except BaseException:
            process.kill()
            raise
        finally:
            killer.cancel()
        wall = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read().decode(errors="replace"))
    unit = 1 if sys.platform == "darwin" else 1024
    return Child(wall, usage.ru_maxrss * unit, process.returncode, *texts)


_CACHES = ("JAX_COMPILATION_CACHE", "JAX_PERSISTENT_CACHE", "MPLCONFIGDIR")


def _environment(extra: Mapping[str, str] | None) -> dict[str, str]:
    """That of this process, without settings that would skip a compilation.

    A smoke run times nothing: there they stay, unless `extra` names other caches.
    """
    extra = dict(extra or {})
    timed = "--smoke" not in sys.argv or "XDG_CACHE_HOME" in extra
    kept = {
        k: v for k, v in os.environ.items() if not (timed and k.startswith(_CACHES))
    }
    return kept | extra


def worker(
    script: str, *arguments: object, python: str = sys.executable, limit: float = 3600.0
) -> tuple[dict[str, Any] | None, Child]:
    """Run `script` in a fresh process; the JSON on its last line, None if it failed."""
    done = child([python, script, *(str(a) for a in arguments)], limit=limit)
    if done.code != 0:
        return None, done
    return json.loads(done.stdout.splitlines()[-1]), done


def results_folder(chosen: str | None, *, smoke: bool) -> Path:
    """Where results go: never into the repository for a smoke run."""
    if chosen is not None:
        return Path(chosen)
    return Path(tempfile.mkdtemp(prefix="jaxnarx-")) if smoke else RESULTS


def benchmark_parser(description: str, smoke: str) -> argparse.ArgumentParser:
    """Flags of every benchmark that has peers; `smoke` says what that flag makes small.

    `--peers` names an interpreter; without a name, this one. `--worker` is for the
    processes that the benchmark itself starts.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--smoke", action="store_true", help=smoke)
    parser.add_argument(
        "--peers",
        nargs="?",
        const=sys.executable,
        metavar="PYTHON",
        help="compare with the peers this interpreter has (default: the own one)",
    )
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--note", default="", help="a remark kept with the figures")
    parser.add_argument("--worker", nargs=2, metavar=("NAME", "JSON"))
    return parser
