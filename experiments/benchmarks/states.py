"""Models with hidden states: derivatives, price of a step, time from file to model.

    derivatives  gradient and normal equations of the free run by all coefficients and
                 all starting values beside central differences
    price        loss, its gradient and its normal equations on 10,000 samples: three
                 hidden states beside a network of as many terms without, in turns
    gates        normal equations of four states, ten delayed inputs and eight gates on
                 20 records: as of networks in which everything computed has the same
                 terms, and as of any network, in turns
    tanks        the cascaded tanks, three states of degree two, from the file to the
                 model in a fresh process: first call, and again when all is compiled

    python experiments/benchmarks/states.py [--only PART ...] [--smoke]

`tanks` needs `$JAXNARX_DATA`. Results: `experiments/benchmarks/results/states.json`.
"""

import json
import os
import statistics
import sys
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
sys.path.insert(0, str(HERE.parent / "open_sets"))
from common import (  # noqa: E402
    benchmark_parser,
    record,
    results_folder,
    target,
    worker,
)

PARTS = ("derivatives", "price", "gates", "tanks")
SAMPLES, ROUNDS = 10_000, 5
STATES, DEGREE = 3, 2
STEP = 1e-6
"""Of the central differences."""
SMALL = 200
"""Samples of a smoke run, the same everywhere: what one part compiles another loads."""
AIMS = {"derivatives": 1e-6, "price": 4.0, "gates": 0.4, "cold": 40.0, "compiled": 10.0}


def plant(samples: int) -> Any:
    """Records of a plant with three states, the first of them measured with noise."""
    import numpy as np

    import jaxnarx as jnx
    from jaxnarx.data import Record

    rng, records = np.random.default_rng(0), []
    for n in range(2):
        u = np.repeat(rng.uniform(-1, 1, samples // 20 + 1), 10)[: samples // 2]
        x, y = np.zeros(3), np.zeros(len(u))
        for t, value in enumerate(u):
            y[t] = x[0]
            x = np.array(
                [
                    0.9 * x[0] + 0.1 * x[1] - 0.02 * x[0] ** 2,
                    0.85 * x[1] + 0.15 * x[2],
                    0.8 * x[2] + 0.2 * value + 0.05 * value**2,
                ]
            )
        y += 0.001 * rng.normal(size=y.size)
        valid = np.ones((len(u), 2), bool)
        records.append(Record(u[:, None], y[:, None], valid, f"record {n + 1}"))
    channels = jnx.Channels((jnx.Channel("u"),), (jnx.Channel("y"),))
    return jnx.Dataset(tuple(records), channels, sample_time=1.0)


def trained(data: Any) -> Any:
    """A network with three hidden states, after a few steps."""
    from jaxnarx.linear import HiddenStates, fit_states

    method = HiddenStates(
        states=STATES,
        degree=DEGREE,
        shrink=(0.1,),
        start="subspace",
        max_steps=2,
        first_steps=2,
    )
    return fit_states(data, method).value


def lagged(data: Any, terms: int) -> Any:
    """A network of so many products of lagged inputs and outputs, fitted one step."""
    import jaxnarx as jnx

    pool = jnx.polynomial_pool(
        data.channels, input_lags=range(5), output_lags=range(1, 6), degree=DEGREE
    )
    select = jnx.ForwardOLS(max_terms=terms)
    found = jnx.identify(data, jnx.Identification(pool=pool, select=select))
    return found.value


def prepared(network: Any, data: Any) -> tuple[Any, Any, Any]:
    """Task, layout and a point of a training, with starting values if it has any."""
    import dataclasses

    import numpy as np

    from jaxnarx.refinement._refine import make_task
    from jaxnarx.refinement.initial import initial_conditions
    from jaxnarx.refinement.layout import make_layout
    from jaxnarx.refinement.shared_terms import shares_terms

    task = make_task(network, data)[0].with_hidden_starts(network)
    initial = initial_conditions(network, task, measured=False)
    layout = make_layout(network, None, (0.5, 2.0), initial, every=True, dense=True)
    layout = dataclasses.replace(layout, shared_terms=shares_terms(layout))
    return task, layout, np.asarray(layout.gather(network))


def derivatives(smoke: bool) -> dict[str, Any]:
    """Largest departure from central differences, as a share of the largest entry."""
    import jax.numpy as jnp
    import numpy as np

    from jaxnarx.refinement.gauss_newton import loss, normal_equations

    data = plant(SMALL if smoke else 600)
    task, layout, u = prepared(trained(data), data)
    u = u + 0.01 * np.random.default_rng(1).normal(size=u.size)
    at = task.drive, task.anchors(None), task.weight

    def value(u: Any) -> float:
        return float(loss(layout, jnp.asarray(u), *at))

    gradient = 2.0 * np.asarray(normal_equations(layout, jnp.asarray(u), *at)[1])
    plain = np.zeros_like(u)
    for k in range(u.size):
        step = np.zeros_like(u)
        step[k] = STEP
        plain[k] = (value(u + step) - value(u - step)) / (2 * STEP)
    parts = {"coefficients": slice(layout.parameters)}
    parts["starting values"] = slice(layout.parameters, u.size)
    found: dict[str, Any] = {"step": STEP}
    for name, part in parts.items():
        error = np.abs(gradient[part] - plain[part]).max() / np.abs(plain[part]).max()
        found[name] = {"count": len(u[part])}
        found[name] |= target(float(f"{error:.3g}"), AIMS["derivatives"])
    return found


def price(smoke: bool) -> dict[str, Any]:
    """Medians over rounds in turns [s]; with hidden states over without."""
    import jax
    import jax.numpy as jnp

    from jaxnarx.evaluation import cost
    from jaxnarx.refinement.gauss_newton import loss, normal_equations

    data = plant(SMALL if smoke else SAMPLES)
    with_states = trained(data)
    terms = cost(with_states).parameters
    networks = {"hidden states": with_states, "without": lagged(data, terms)}
    calls = {}
    for name, network in networks.items():
        task, layout, u = prepared(network, data)
        at = task.drive, task.anchors(None), task.weight

        def of(u, layout=layout, at=at):
            return loss(layout, u, *at)

        def normal(u, layout=layout, at=at):
            return normal_equations(layout, u, *at)

        point = jnp.asarray(u)
        for what, made in (
            ("loss", jax.jit(of)),
            ("loss and gradient", jax.jit(jax.value_and_grad(of))),
            ("normal equations", jax.jit(normal)),
        ):
            calls[what, name] = lambda made=made, point=point: jax.block_until_ready(
                made(point)
            )
    times: dict[tuple[str, str], list[float]] = {key: [] for key in calls}
    for call in calls.values():
        call()
    for _ in range(1 if smoke else ROUNDS):
        for key, call in calls.items():
            begin = time.perf_counter()
            call()
            times[key].append(time.perf_counter() - begin)
    found: dict[str, Any] = {
        "samples": data.samples,
        "terms": {name: cost(n).parameters for name, n in networks.items()},
    }
    for what in dict.fromkeys(what for what, _ in calls):
        both = [statistics.median(times[what, name]) for name in networks]
        found[what] = {
            name: float(f"{value:.3g}")
            for name, value in zip(networks, both, strict=True)
        }
        found[what]["ratio"] = target(round(both[0] / both[1], 2), AIMS["price"])
    return found


def many_records(samples: int) -> Any:
    """Of five inputs, through two lags and a bend."""
    import numpy as np

    import jaxnarx as jnx

    us, ys = [], []
    for n in range(20):
        rng = np.random.default_rng(n)
        rows = samples // 20
        u = np.repeat(rng.uniform(-1, 1, size=(rows // 10 + 1, 5)), 10, axis=0)[:rows]
        x = np.zeros((rows, 2))
        for t in range(1, rows):
            drive = np.array([u[t] @ [1.0, 0.5, -0.3, 0.2, 0.0], np.tanh(u[t, 0] * 2)])
            x[t] = [0.9, 0.98] * x[t - 1] + [0.1, 0.02] * drive
        us.append(u)
        ys.append(x.sum(axis=1, keepdims=True) + 0.01 * rng.normal(size=(rows, 1)))
    names = [f"u{n}" for n in range(5)]
    return jnx.Dataset.from_arrays(us, ys, inputs=names, outputs=["y"], sample_time=0.1)


def gates(smoke: bool) -> dict[str, Any]:
    """Medians over rounds in turns [s] and their ratio, and how far the results are
    from each other, as a share of the largest entry."""
    import dataclasses

    import jax
    import numpy as np

    from jaxnarx.linear import HiddenStates, fit_states
    from jaxnarx.refinement.gauss_newton import normal_equations

    data = many_records(20 * SMALL if smoke else 2 * SAMPLES)
    method = HiddenStates(
        states=4,
        degree=1,
        gates=8,
        draw=1,
        times=(0.2, 1.0, 3.0, 8.0),
        shrink=(0.01,),
        max_steps=1,
        first_steps=1,
    )
    network = fit_states(data, method).value
    task, layout, u = prepared(network, data)
    assert layout.shared_terms
    general = dataclasses.replace(layout, shared_terms=False)
    at = task.drive, task.anchors(None), task.weight
    ways = {"shared terms": layout, "any network": general}
    ends = {
        name: jax.block_until_ready(normal_equations(one, u, *at))
        for name, one in ways.items()
    }
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(1 if smoke else ROUNDS):
        for name, one in ways.items():
            begin = time.perf_counter()
            jax.block_until_ready(normal_equations(one, u, *at))
            times[name].append(time.perf_counter() - begin)
    taken = {name: statistics.median(own) for name, own in times.items()}
    a, b = (np.asarray(ends[name][2]) for name in ways)
    found: dict[str, Any] = {name: float(f"{s:.3g}") for name, s in taken.items()}
    found |= {
        "samples": data.samples,
        "records": len(data),
        "parameters": layout.parameters,
        "apart": float(f"{np.abs(a - b).max() / np.abs(b).max():.3g}"),
    }
    ratio = taken["shared terms"] / taken["any network"]
    return found | {"ratio": target(round(ratio, 3), AIMS["gates"])}


def tanks(smoke: bool) -> dict[str, Any]:
    """Seconds of the first call in a fresh process, imports included, and again."""
    begin = time.perf_counter()
    import jax

    jax.config.update("jax_enable_x64", True)
    import numpy as np
    from own import load  # pyright: ignore[reportMissingImports]

    from jaxnarx.linear import HiddenStates, fit_states

    imported = time.perf_counter() - begin
    folder = Path(os.environ.get("JAXNARX_DATA", "../shared/data")).resolve()
    method = HiddenStates(states=STATES, degree=DEGREE)
    seconds, network = [], None
    for _ in range(2):
        begin = time.perf_counter()
        data = load("cascaded_tanks", str(folder), small=smoke).train
        network = fit_states(data, method).value
        seconds.append(time.perf_counter() - begin)
    assert network is not None
    return {
        "imports_s": round(imported, 1),
        "cold_s": target(round(imported + seconds[0], 1), AIMS["cold"]),
        "compiled_s": target(round(seconds[1], 1), AIMS["compiled"]),
        "coefficients": int(
            sum(np.asarray(m.local.used).sum() for m in network.models)
        ),
    }


def main() -> None:
    """Every part in a process of its own, and the file."""
    parser = benchmark_parser(__doc__ or "", "short records, one round")
    parser.add_argument("--only", nargs="+", choices=PARTS, help="default: all")
    chosen = parser.parse_args()
    if chosen.worker:
        import jax

        jax.config.update("jax_enable_x64", True)
        name, options = chosen.worker
        print(json.dumps(globals()[name](**json.loads(options))))
        return
    figures: dict[str, Any] = {}
    for name in chosen.only or PARTS:
        asked = json.dumps({"smoke": chosen.smoke})
        found, done = worker(str(Path(__file__).resolve()), "--worker", name, asked)
        if found is None:
            raise SystemExit(f"{name}: {done.stderr.splitlines()[-1:]}")
        figures[name] = found | {"peak_mb": round(done.peak / 1e6)}
        print(name, figures[name], flush=True)
    folder = results_folder(chosen.results, smoke=chosen.smoke)
    print(record("states", figures, folder=folder, note=chosen.note))


if __name__ == "__main__":
    main()
