"""`check` and `suggest_lags` of long data: time, and memory of the whole process.

2 million rows of eight inputs, each held for 20 to 160 samples, and two outputs that
answer four of them each as first-order lags, with noise of 5 %. With `--before FOLDER`
the code of another checkout does the same in the same run.

    python experiments/benchmarks/check.py [--smoke] [--before FOLDER] [--results DIR]
"""

import json
import sys
import time
from typing import Any

from common import ROOT, benchmark_parser, child, record, results_folder, target

ROWS, INPUTS = 2_000_000, 8
LIMIT_SECONDS, LIMIT_BYTES = 15.0, 1_000_000_000
NOTES = {
    "seconds": "wall clock of both calls; processor adds up all threads. On a machine "
    "that does other work the wall clock tells of that too",
    "peak_bytes": "of the process from its beginning: data (180 MB), imports and all",
}


def dataset(rows: int):
    """The records, with little memory beside their own."""
    import numpy as np
    from scipy.signal import lfilter

    from jaxnarx.data import Dataset

    rng = np.random.default_rng(0)
    u, y = np.empty((rows, INPUTS)), np.zeros((rows, 2))
    for k in range(INPUTS):
        hold = 20 * (k + 1)
        u[:, k] = np.repeat(rng.uniform(-1, 1, rows // hold + 1), hold)[:rows]
        a = (0.9, 0.98)[k // 4]
        y[:, k // 4] += np.asarray(lfilter([1 - a], [1, -a], u[:, k]))
    for column in y.T:
        column += 0.05 * column.std() * rng.standard_normal(rows)
    inputs = [f"u{k + 1}" for k in range(INPUTS)]
    return Dataset.from_arrays(
        u, y, inputs=inputs, outputs=["y1", "y2"], sample_time=0.1
    )


def measured(rows: int) -> dict[str, Any]:
    """Both calls once."""
    from jaxnarx.data import check, suggest_lags

    data = dataset(rows)
    wall, processor = time.perf_counter(), time.process_time()
    findings, lags = check(data), suggest_lags(data)
    return {
        "seconds": time.perf_counter() - wall,
        "processor_seconds": time.process_time() - processor,
        "findings": len(findings),
        "responses_seen": sum(d is not None for d in lags.dead_time.values()),
    }


def run(rows: int, folder: str) -> dict[str, Any]:
    """In a fresh process with the code of `folder`, or why it failed."""
    options = json.dumps({"rows": rows})
    done = child(
        [sys.executable, __file__, "--worker", "measured", options],
        environment={"PYTHONPATH": folder},
    )
    if done.code != 0:
        return {"failed": done.stderr.strip().splitlines()[-1:]}
    return json.loads(done.stdout.splitlines()[-1]) | {"peak_bytes": done.peak}


def main() -> None:
    """Run what the command line asks for."""
    parser = benchmark_parser("A look at long data.", "50,000 rows")
    parser.add_argument("--before", metavar="FOLDER", help="a checkout to compare with")
    chosen = parser.parse_args()
    if chosen.worker:
        print(json.dumps(measured(**json.loads(chosen.worker[1]))))
        return
    rows = 50_000 if chosen.smoke else ROWS
    now = run(rows, str(ROOT))
    figures = {
        "rows": rows,
        "channels": INPUTS + 2,
        "responses": INPUTS,
        "now": now,
        "before": run(rows, chosen.before) if chosen.before else None,
        "notes": NOTES,
        "targets": {
            "seconds": target(now.get("seconds"), LIMIT_SECONDS),
            "peak_bytes": target(now.get("peak_bytes"), LIMIT_BYTES),
        },
    }
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    path = record("check", figures, folder=folder, note=chosen.note)
    print(path, figures["now"], figures["before"], figures["targets"])


if __name__ == "__main__":
    main()
