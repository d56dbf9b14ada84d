"""Measurement files: MDF4 beside asammdf's own reading, and one of a gigabyte.

Two files are written by asammdf, with deflate over transposed records as measuring
tools do: 2 million samples of ten channels, and 400 channels on rasters of 10 ms and
100 ms (300 and 100 of them) of which ten are wanted. Every reading is a process of its
own; asammdf reads by `select`, which goes through a group once, and comes after ours
and before it, by turns. Of the large file the channels are brought to 100 ms and
checked.

    python experiments/benchmarks/readers.py [--smoke] [--results DIR]
"""

import contextlib
import json
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from common import benchmark_parser, child, record, results_folder, target

CHANNELS, SAMPLES = 10, 2_000_000
FAST, SLOW = 300, 100
LARGE = 2_000_000
"""Samples of the fast channels of the large file; a tenth as many of the slow ones."""
RATIO, LIMIT_SECONDS, LIMIT_BYTES = 1.5, 60.0, 2e9
ROUNDS = 3
NOTES = {
    "seconds": "wall clock of a whole process: interpreter, imports, reading",
    "reading": "of it the reading alone, with the process that reads begun within it",
    "peak_bytes": "of a process; of ours the most that it and the one that reads for it"
    " held at any time, looked at every 10 ms, files that are mapped counted as held",
    "peaks": "of our two processes, each at its own time",
}


def sensor(rng: Any, count: int) -> Any:
    """A signal of sixteen bits with its noise in the lower ten."""
    import numpy as np

    slow = np.cumsum(rng.standard_normal(count // 100 + 2))
    x = np.interp(np.arange(count) / 100, np.arange(len(slow)), slow)
    x = 2**15 + 2**9 * x / max(float(np.abs(x).max()), 1.0) * 30
    return np.clip(x + 2**8 * rng.standard_normal(count), 0, 2**16 - 1)


def write(path: str, groups: list[list[Any]]) -> dict[str, Any]:
    """Groups of (channels, samples, step [s]) as MDF4; channels are x0, x1, ..."""
    import numpy as np
    from asammdf import MDF, Signal

    rng = np.random.default_rng(0)
    place, name = Path(path), 0
    with MDF(version="4.10") as mdf:
        for channels, samples, step in groups:
            t, signals = step * np.arange(samples), []
            for _ in range(channels):
                x = sensor(rng, samples).astype(np.uint16).astype(np.float32)
                signals.append(Signal(x, t, name=f"x{name}", unit="rpm"))
                name += 1
            mdf.append(signals, common_timebase=True)
            del signals
        mdf.save(place, overwrite=True, compression=2)
    return {"bytes": place.stat().st_size}


def ours(path: str, names: list[str], step: float | None) -> dict[str, Any]:
    """What a description of the file would be read by; checked where resampled."""
    import resource

    from jaxnarx.data.readers import read_table
    from jaxnarx.data.readers.columns import Asked

    held = [0]
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(0.01):
            held.append(_held())

    watching = threading.Thread(target=watch)
    watching.start()
    begin = time.perf_counter()
    table = read_table(Path(path), names, Asked(sample_time=step))
    reading = time.perf_counter() - begin
    found: dict[str, Any] = {"reading": reading, "rows": len(table)}
    if step is not None:
        import numpy as np

        from jaxnarx.data import Dataset, check

        half = len(names) // 2
        u, y = (
            np.stack([table.columns[n].to_numpy() for n in part], axis=1)
            for part in (names[:half], names[half:])
        )
        data = Dataset.from_arrays(
            u, y, inputs=names[:half], outputs=names[half:], sample_time=step
        )
        found["findings"] = len(check(data))
        found["check"] = time.perf_counter() - begin - reading
    ended.set()
    watching.join()
    from jaxnarx.data.readers.sandbox import close

    close()
    peaks = [
        resource.getrusage(who).ru_maxrss * 1024
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    ]
    return found | {"peak_bytes": max(held), "peaks": peaks}


def _held() -> int:
    """Bytes that this process and its children hold now."""
    own = Path("/proc/self/task") / str(threading.main_thread().native_id) / "children"
    held = 0
    for name in ["self", *own.read_text().split()]:
        with contextlib.suppress(OSError, IndexError):
            status = Path("/proc", name, "status").read_text()
            held += 1024 * int(status.split("VmRSS:")[1].split()[0])
    return held


def theirs(path: str, names: list[str]) -> dict[str, Any]:
    """asammdf alone."""
    from asammdf import MDF

    begin = time.perf_counter()
    with MDF(path) as mdf:
        signals = mdf.select(names)
    return {"reading": time.perf_counter() - begin, "rows": len(signals[0].samples)}


def run(what: str, **options: Any) -> dict[str, Any]:
    """In a fresh process, or why it failed."""
    done = child([sys.executable, __file__, "--worker", what, json.dumps(options)])
    if done.code != 0:
        return {"failed": done.stderr.strip().splitlines()[-1:]}
    return (
        {"peak_bytes": done.peak}
        | json.loads(done.stdout.splitlines()[-1])
        | {"seconds": done.wall}
    )


def main() -> None:
    """Run what the command line asks for."""
    chosen = benchmark_parser("Reading measurement files.", "small files").parse_args()
    if chosen.worker:
        work = {"ours": ours, "theirs": theirs, "write": write}[chosen.worker[0]]
        print(json.dumps(work(**json.loads(chosen.worker[1]))))
        return
    share = 0.002 if chosen.smoke else 1
    figures: dict[str, Any] = {"notes": NOTES}
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "plain.mf4")
        names = [f"x{k}" for k in range(CHANNELS)]
        size = run("write", path=path, groups=[[CHANNELS, int(share * SAMPLES), 0.01]])
        turns = []
        for _ in range(1 if chosen.smoke else ROUNDS):
            own = run("ours", path=path, names=names, step=None)
            turns.append(
                {"ours": own, "asammdf": run("theirs", path=path, names=names)}
            )
        ratios = sorted(t["ours"]["seconds"] / t["asammdf"]["seconds"] for t in turns)
        figures["plain"] = size | {"turns": turns, "ratios": ratios}
        path = str(Path(folder) / "large.mf4")
        rows = int(share * LARGE)
        groups = [[FAST, rows, 0.01], [SLOW, rows // 10, 0.1]]
        size = run("write", path=path, groups=groups)
        names = [f"x{k}" for k in (0, 50, 100, 150, 299, 300, 320, 340, 360, 399)]
        large = run("ours", path=path, names=names, step=0.1)
        other = run("theirs", path=path, names=names)
        figures["large"] = size | {"ours": large, "asammdf": other}
    figures["targets"] = {
        "ratio": target(ratios[len(ratios) // 2], RATIO),
        "seconds": target(large["seconds"], LIMIT_SECONDS),
        "peak_bytes": target(large["peak_bytes"], LIMIT_BYTES),
    }
    versions = {"asammdf": _version()}
    place = results_folder(chosen.results, smoke=chosen.smoke)
    path = record("readers", figures, folder=place, versions=versions, note=chosen.note)
    print(path, json.dumps(figures, indent=1))


def _version() -> str:
    import importlib.metadata

    return importlib.metadata.version("asammdf")


if __name__ == "__main__":
    main()
