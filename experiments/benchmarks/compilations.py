"""Programs that a flow compiles, and what the command line takes with and without them.

Select, grow, refine and report of one record of 600 samples and one of 300 that
judges: for the first time, again, with a sample more, with other names, with a lag
more. Then `jaxnarx identify` on 1,000 samples with an empty cache and with a full one,
in processor seconds of the whole process. With `--before DIR` another checkout does the
same in the same run.

    python experiments/benchmarks/compilations.py [--smoke] [--before DIR]
"""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

from common import ROOT, child, record, results_folder, target

COLD, WARM, FIRST = 8.0, 4.0, 40
"""Aims: processor seconds of the command line, and programs of a first flow."""
DESCRIPTION = """
[data]
sample_time = 0.1
[channels.inputs]
u = ""
w = ""
[channels.outputs]
y = ""
[records]
train = ["train.csv"]
test = ["test.csv"]
"""


def signals(samples: int, seed: int):
    """Two inputs in steps, and an output with a bent gain."""
    import numpy as np

    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, (samples // 5 + 1, 2)), 5, axis=0)[:samples]
    y = np.zeros(samples)
    for t in range(2, samples):
        y[t] = 0.7 * y[t - 1] - 0.1 * y[t - 2] + 0.3 * np.tanh(2 * u[t - 1, 0])
        y[t] += 0.2 * u[t - 2, 1] * (1 + 0.5 * u[t - 1, 0])
    return u, y + 0.01 * rng.normal(size=samples)


def flow(samples: int, names=("u", "w", "y"), lags: int = 3) -> None:
    """From data to report."""
    import jaxnarx as jnx

    def dataset(samples: int, seed: int):
        u, y = signals(samples, seed)
        inputs, outputs = names[:2], names[2:]
        return jnx.Dataset.from_arrays(
            [u], [y[:, None]], inputs=inputs, outputs=outputs, sample_time=0.1
        )

    data, judge = dataset(samples, 0), dataset(samples // 2, 1)
    pool = jnx.polynomial_pool(
        data.channels, input_lags=range(lags), output_lags=(1, 2), degree=2
    )
    chosen = jnx.select(pool, data, jnx.ForwardOLS(max_terms=8)).value
    parts = jnx.Lolimot(scheduling=[f"{names[0]}[t-1]"], max_models=3)
    grown = jnx.grow(chosen, data, parts).value
    fine = jnx.refine(grown, data, jnx.SimulationError(), validation=judge).value
    jnx.report(fine, data).to_dict()


def programs(samples: int) -> dict[str, int]:
    """How many programs every turn of the flow compiles."""
    import jax
    from jax import monitoring

    jax.config.update("jax_enable_x64", True)
    count = [0]

    def heard(event: str, duration_secs: float, **kwargs: str | int) -> None:
        del duration_secs, kwargs
        count[0] += event == "/jax/core/compile/backend_compile_duration"

    monitoring.register_event_duration_secs_listener(heard)
    turns: dict[str, dict[str, Any]] = {
        "first": {"samples": samples},
        "same": {"samples": samples},
        "one more sample": {"samples": samples + 1},
        "renamed": {"samples": samples + 1, "names": ("speed", "load", "NOx")},
        "one more lag": {"samples": samples + 1, "lags": 4},
    }
    found = {}
    for name, given in turns.items():
        before = count[0]
        flow(**given)
        found[name] = count[0] - before
    return found


def command(samples: int, *, once: bool) -> dict[str, float]:
    """Processor seconds of `jaxnarx identify`, cold and warm (the better of two, unless
    it is to run `once`)."""
    import numpy as np

    found = {}
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        u, y = signals(samples, 0)
        cut = samples * 6 // 10
        for name, part in (("train", slice(cut)), ("test", slice(cut, None))):
            np.savetxt(
                home / f"{name}.csv",
                np.c_[u[part], y[part]],
                delimiter=",",
                header="u,w,y",
                comments="",
            )
        (home / "engine.toml").write_text(DESCRIPTION, encoding="utf-8")
        for n, name in enumerate(("cold", "warm", "warm")[: 2 if once else 3]):
            # The usual settings, stated: without any it would be a search.
            arguments = ["identify", "engine.toml", "--out", f"run {n}", "--root", "."]
            arguments += ["--terms", "25"]
            spent = _processor_seconds(arguments, home)
            found[name] = min(spent, found.get(name, spent))
    return found


def _processor_seconds(arguments: list[str], home: Path) -> float:
    before = os.times()
    code = "from jaxnarx.shell.cli import main; main()"
    done = child(
        [sys.executable, "-c", code, *arguments],
        environment={"XDG_CACHE_HOME": str(home / "cache")},
        cwd=home,
    )
    if done.code:
        raise SystemExit(f"jaxnarx {' '.join(arguments)} failed:\n{done.stderr}")
    after = os.times()
    spent = after.children_user + after.children_system
    return round(spent - before.children_user - before.children_system, 2)


WORKERS = "programs", "command"


def measure(checkout: Path, smoke: bool) -> dict[str, Any]:
    """Both workers, each in a fresh process with the package of that checkout."""
    found = {}
    for name in WORKERS:
        path = os.pathsep.join(
            filter(None, (str(checkout), os.environ.get("PYTHONPATH")))
        )
        done = child(
            [sys.executable, __file__, "--worker", name, *["--smoke"] * smoke],
            environment={"PYTHONPATH": path},
            cwd=checkout,
        )
        if done.code:
            raise SystemExit(f"{name} failed in {checkout.name}:\n{done.stderr}")
        found[name] = json.loads(done.stdout.splitlines()[-1])
        print(checkout.name, name, found[name], flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", metavar="DIR", help="a checkout of another version")
    parser.add_argument("--smoke", action="store_true", help="everything small")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--note", default="", help="a remark kept with the figures")
    parser.add_argument("--worker", choices=WORKERS)
    options = parser.parse_args()
    if options.worker:
        small = options.smoke
        if options.worker == "programs":
            counted = programs(200 if small else 600)
        else:
            counted = command(300 if small else 1_000, once=small)
        print(json.dumps(counted))
        return
    figures: dict[str, Any] = {}
    if options.before:
        figures["before"] = measure(Path(options.before).resolve(), options.smoke)
    now = figures["after"] = measure(ROOT, options.smoke)
    figures["aims"] = {
        "first": target(now["programs"]["first"], FIRST),
        "one more sample": target(now["programs"]["one more sample"], 0),
        "renamed": target(now["programs"]["renamed"], 0),
        "cold": target(now["command"]["cold"], COLD),
        "warm": target(now["command"]["warm"], WARM),
    }
    folder = results_folder(options.results, smoke=options.smoke)
    print(record("compilations", figures, folder=folder, note=options.note))


if __name__ == "__main__":
    main()
