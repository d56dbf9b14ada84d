"""An exported network in C beside a loop written by hand, and beside `simulate`.

A network of six regions (Gaussians over two inputs) of 16 terms each: three inputs at
lags 0 and 1, two lags of the output, products of inputs. The loop by hand keeps the
same tables and goes through regions and terms. FMUs of FMI 2.0 and 3.0 step through the
functions of the standard, inputs set and outputs got at every sample, those of 3.0 in
event mode. All run the same million samples, one after the other, by turns.

    python experiments/benchmarks/exports.py [--smoke] [--results DIR]
"""

import ctypes
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from common import benchmark_parser, child, record, results_folder, target

SAMPLES, REGIONS, TERMS, ROUNDS = 1_000_000, 6, 16, 5
RATIO = 2.0
FMU_SECONDS = 10.0
FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared")
NOTES = {
    "ratio": "median over turns of seconds, exported over by hand",
    "over exported": "median over turns of seconds, over the exported C",
    "difference": "to `simulate`, largest, in shares of the output's largest value",
    "export": "seconds of writing C from the network and proving it",
    "fmu": "seconds of an FMU with its binary, without proof and with, and bytes",
}

BY_HAND = """#include <math.h>
#define REGIONS %d
#define TERMS %d
static const double centre[REGIONS][2] = {%s};
static const double narrow[REGIONS][2] = {%s};
static const int factor[TERMS][2] = {%s};
static const double theta[REGIONS][TERMS] = {%s};
static const double gain[4] = {%s};
void run(int n, const double *u, const double *y, double *out);
void run(int n, const double *u, const double *y, double *out)
{
    double v[9], past[2], x[3], old[3], term[TERMS], weight[REGIONS];
    int t, k, m;
    for (k = 0; k < 3; k++) {
        old[k] = u[3 + k] / gain[k];
    }
    past[0] = y[1] / gain[3];
    past[1] = y[0] / gain[3];
    for (t = 2; t < n; t++) {
        double total = 0.0, now = 0.0;
        for (k = 0; k < 3; k++) {
            x[k] = u[3 * t + k] / gain[k];
        }
        v[0] = 1.0;
        for (k = 0; k < 3; k++) {
            v[1 + k] = x[k];
            v[4 + k] = old[k];
        }
        v[7] = past[0];
        v[8] = past[1];
        for (k = 0; k < TERMS; k++) {
            term[k] = v[factor[k][0]] * v[factor[k][1]];
        }
        for (m = 0; m < REGIONS; m++) {
            double a = (x[0] * gain[0] - centre[m][0]) * narrow[m][0];
            double b = (x[1] * gain[1] - centre[m][1]) * narrow[m][1];
            weight[m] = exp(-0.5 * (a * a + b * b));
            total += weight[m];
        }
        for (m = 0; m < REGIONS; m++) {
            double local = 0.0;
            for (k = 0; k < TERMS; k++) {
                local += theta[m][k] * term[k];
            }
            now += weight[m] * local;
        }
        now /= total;
        now = (now < -50.0) ? -50.0 : (now > 50.0) ? 50.0 : now;
        out[t - 2] = now * gain[3];
        past[1] = past[0];
        past[0] = now;
        for (k = 0; k < 3; k++) {
            old[k] = x[k];
        }
    }
}
"""


def network_and_data(samples: int) -> tuple[Any, Any, str]:
    """The network, a record, and the loop by hand as C."""
    import jax
    import numpy as np

    from jaxnarx.data import Channel, Channels, Dataset
    from jaxnarx.models import Gaussians, Network
    from jaxnarx.models._assemble import local_models, output_model
    from jaxnarx.regressors import Variables

    rng = np.random.default_rng(0)
    rows = [(k, d) for d in (0, 1) for k in range(3)] + [(3, 1), (3, 2)]
    factor = [(0, 0), *((0, k) for k in range(1, 9))]
    factor += [(1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3), (4, 5)]
    theta = rng.normal(0, 0.2, (REGIONS, TERMS))
    theta[:, 7], theta[:, 8] = 0.5, 0.2
    centre, width = rng.uniform(0, 1, (REGIONS, 2)), rng.uniform(0.2, 0.4, (REGIONS, 2))
    gain = np.array([2.0, 0.5, 3.0, 100.0])
    offset, span = np.array([-2.0, -0.5]), np.array([4.0, 1.0])
    validity = Gaussians(*jax.device_put((centre, np.log(width))))
    local = local_models(np.array(factor), theta)
    over = Variables(((0, 0), (1, 0)))
    model = output_model(local, validity, over, offset, span)
    inputs = tuple(Channel(name) for name in ("speed", "fuel", "egr"))
    channels = Channels(inputs, (Channel("NOx", "ppm"),))
    low = np.array([-2.0, -0.5, -3.0, -5000.0])
    leaves = gain, np.array([-50.0]), np.array([50.0]), low, -low, np.array(0.1)
    variables = Variables(tuple(rows))
    net = Network(channels, (0,), variables, (model,), *map(jax.device_put, leaves))
    levels = rng.uniform(low[:3], -low[:3], (samples // 20 + 1, 3))
    u = np.repeat(levels, 20, axis=0)[:samples]
    data = Dataset.from_arrays(
        u,
        np.zeros((samples, 1)),
        inputs=inputs,
        outputs=channels.outputs,
        sample_time=0.1,
    )

    def table(values: Any) -> str:
        return ", ".join(
            "{" + ", ".join(repr(x) for x in row) + "}"
            for row in np.asarray(values).tolist()
        )

    text = BY_HAND % (
        REGIONS,
        TERMS,
        table(centre * span + offset),
        table(1 / (width * span)),
        table(factor),
        table(theta),
        ", ".join(map(repr, gain.tolist())),
    )
    return net, data, text


def measured(samples: int, rounds: int) -> dict[str, Any]:
    """Seconds of every round by turns, and how far the three are apart."""
    import jax
    import numpy as np

    jax.config.update("jax_enable_x64", True)
    from jaxnarx.exporters import export, lower
    from jaxnarx.exporters.fmu.prove import fmu_runner
    from jaxnarx.exporters.runners import c_runner
    from jaxnarx.simulation import simulate

    net, data, by_hand = network_and_data(samples)
    begin = time.perf_counter()
    exported = export(net, data[:1] if samples < 20_000 else None, name="NOx")
    figures: dict[str, Any] = {"export": time.perf_counter() - begin, "fmu": {}}
    packed: dict[str, bytes] = {}
    for target_name in ("fmu2", "fmu3"):
        made = {}
        for what, verify in (("made", False), ("proven", True)):
            begin = time.perf_counter()
            found = export(net, to=[target_name], name="NOx", verify=verify)
            made[what] = time.perf_counter() - begin
        packed |= {k: v for k, v in found.files.items() if isinstance(v, bytes)}
        made["bytes"] = sum(map(len, found.files.values()))
        figures["fmu"][target_name] = made
    expected = np.asarray(simulate(net, data).value[0])[2:]
    u, y = np.ascontiguousarray(data.records[0].u), np.zeros((3, 1))
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, text in {**exported.texts, "hand.c": by_hand}.items():
            (folder / name).write_text(text)
        for name, content in packed.items():
            (folder / name).write_bytes(content)
        program = lower(net, "NOx")
        ours = c_runner(folder, program, folder, single=False)
        units = {n: fmu_runner(folder, program, n) for n in (2, 3)}
        library = folder / "hand.so"
        command = ["cc", *FLAGS, str(folder / "hand.c"), "-lm", "-o", str(library)]
        subprocess.run(command, check=True)
        call = ctypes.CDLL(str(library)).run

        def hand(u: Any, y: Any) -> Any:
            out = np.zeros((len(u) - 2, 1))
            call(len(u), *(a.ctypes.data_as(ctypes.c_void_p) for a in (u, y, out)))
            return out

        runs = {
            "exported": lambda: ours(u, y),
            "by hand": lambda: hand(u, y),
            **{f"fmu{n}": lambda f=f: f(u, y) for n, f in units.items() if f},
            "simulate": lambda: np.asarray(simulate(net, data).value[0])[2:],
        }
        seconds: dict[str, list[float]] = {name: [] for name in runs}
        difference = {}
        for _ in range(rounds):
            for name, run in runs.items():
                begin = time.perf_counter()
                found = run()
                seconds[name].append(time.perf_counter() - begin)
                off = np.max(np.abs(found - expected)) / np.max(np.abs(expected))
                difference[name] = float(off)

    def over(one: str, other: str) -> float:
        pairs = zip(seconds[one], seconds[other], strict=True)
        ratios = sorted(a / b for a, b in pairs)
        return ratios[len(ratios) // 2]

    others = [name for name in seconds if name not in ("exported", "by hand")]
    return figures | {
        "samples": samples,
        "operations": exported.operations,
        "parameters": exported.parameters,
        "seconds": seconds,
        "ratio": over("exported", "by hand"),
        "over exported": {name: over(name, "exported") for name in others},
        "difference": difference,
    }


def main() -> None:
    """Run what the command line asks for."""
    chosen = benchmark_parser("An exported network.", "2,000 samples").parse_args()
    if chosen.worker:
        print(json.dumps(measured(**json.loads(chosen.worker[1]))))
        return
    options = {"samples": 2000 if chosen.smoke else SAMPLES}
    options["rounds"] = 1 if chosen.smoke else ROUNDS
    words = [sys.executable, __file__, "--worker", "measured", json.dumps(options)]
    done = child(words)
    if done.code != 0:
        sys.exit(done.stderr)
    figures = json.loads(done.stdout.splitlines()[-1]) | {"notes": NOTES}
    slowest = max(made["proven"] for made in figures["fmu"].values())
    figures["targets"] = {
        "ratio": target(figures["ratio"], RATIO),
        "seconds of an FMU": target(slowest, FMU_SECONDS),
    }
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    path = record("exports", figures, folder=folder, note=chosen.note)
    print(path, json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
