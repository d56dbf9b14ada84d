"""What the simulation benchmark measures of the package, each in a fresh process.

Calls that are compared with one another are timed in turn. Only the standard library is
imported here; the rest inside the functions.
"""

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

from common import resident
from simulation_data import LIMIT, SCHEDULING, START, VARIABLES, inputs, tables

BURST = 5
"""Calls in a row within one turn, as the peers are called too: the first after another
program's turn pays for that one's cold caches and sleeping threads."""


def in_turn(calls: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, Any]:
    """Best and median wall time [s] of every call, and of the first, which compiles."""
    import jax

    def timed(call):
        begin = time.perf_counter()
        jax.block_until_ready(call())
        return time.perf_counter() - begin

    first = {name: timed(call) for name, call in calls.items()}
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            times[name] += [timed(call) for _ in range(BURST)]
    return {
        name: {
            "first": float(f"{first[name]:.4g}"),
            "best": float(f"{min(row):.4g}"),
            "median": float(f"{statistics.median(row):.4g}"),
        }
        for name, row in times.items()
    }


def make_network(models: int, terms: int, seed: int = 0):
    """The benchmark's network with that many local models and terms in each."""
    import jax
    import jax.numpy as jnp

    from jaxnarx.data import Channel, Channels
    from jaxnarx.models import Gaussians, LocalModels, Network, OutputModel
    from jaxnarx.regressors import Variables

    jax.config.update("jax_enable_x64", True)
    t = {k: jnp.asarray(v) for k, v in tables(models, terms, seed).items()}
    local = LocalModels(
        t["factor"], t["index"], jnp.ones(t["index"].shape, bool), t["coefficient"]
    )
    model = OutputModel(
        Variables(SCHEDULING),
        jnp.full(2, -1.0),
        jnp.full(2, 2.0),
        Gaussians(t["centre"], jnp.log(t["width"])),
        jnp.ones(models, bool),
        local,
    )
    return Network(
        Channels((Channel("a"), Channel("b")), (Channel("y"),)),
        (0,),
        Variables(VARIABLES),
        (model,),
        jnp.ones(3),
        jnp.full(1, -LIMIT),
        jnp.full(1, LIMIT),
        jnp.full(3, -9.0),
        jnp.full(3, 9.0),
        jnp.asarray(0.1),
    )


def make_records(network, samples: int, records: int = 1):
    """`RunInputs` and anchors of records: the network's own outputs, with noise."""
    import jax.numpy as jnp
    import numpy as np

    from jaxnarx.data.batch import Batch
    from jaxnarx.simulation import RunInputs, make_drive, run

    u = np.stack([inputs(samples, seed=n) for n in range(records)])
    signals = np.concatenate([u, np.zeros((records, samples, 1))], axis=2)
    valid = np.ones(signals.shape, bool)
    drive = make_drive(network, Batch(jnp.asarray(signals), valid))
    first = jnp.arange(samples) == START
    anchor = jnp.broadcast_to(first[None], (records, samples))
    noise = 0.05 * np.random.default_rng(5).normal(size=(records, samples, 1))
    measured = run(network, drive, anchor) + jnp.asarray(noise)
    return RunInputs(drive.v, drive.x, measured, drive.known), anchor, u


def plain_run(network, v, x, measured, anchor):
    """The general step in a scan that jax differentiates itself, to compare with."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    from jaxnarx.arrays.recurrence import past_outputs
    from jaxnarx.models import depth, general_step

    step, params = general_step(network), eqx.filter(network, eqx.is_array)
    fresh = past_outputs(measured, depth(network))

    def body(past, row):
        drive, fresh_t, anchor_t = row
        past = jnp.where(anchor_t, fresh_t, past)
        y = jnp.clip(step(params, drive, past), network.lower, network.upper)
        return jnp.concatenate([y[:, None], past[:, :-1]], axis=1), y

    rows = (v.T, tuple(x_o.T for x_o in x)), fresh, anchor
    return jax.lax.scan(body, fresh[0], rows)[1]


def run_model(path: str, samples: int, repeats: int, autodiff: bool) -> dict[str, Any]:
    """Free run, loss and gradient; writes what the peers need.

    `loop` is the run on ready coefficients G_t, as the compiled loop of the peers has
    them; `free_run` starts from lagged variables and parameters, and so do the loss
    and its gradient by coefficients, centres and widths.
    """
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxnarx.arrays.recurrence import free_run
    from jaxnarx.models import depth, recursion, run_record
    from jaxnarx.models.feedback import monomials
    from jaxnarx.refinement.layout import freeze

    network = make_network(6, 8)
    drive, anchors, u = make_records(network, samples)
    args = drive.v[0], tuple(x[0] for x in drive.x), drive.measured[0], anchors[0]
    v, x, measured, anchor = args
    moving, fixed = eqx.partition(network, freeze(network))
    step, params, g = recursion(network, v, x)
    bounds, lags = (network.lower, network.upper), depth(network)

    def loss(moving, run, *args):
        error = run(eqx.combine(moving, fixed), *args) - args[2]
        return jnp.sum(jnp.where(jnp.cumsum(args[3])[:, None] > 0, error, 0.0) ** 2)

    def compiled(function, *given):
        ready = jax.jit(function)
        return lambda: ready(*given)

    calls = {
        "loop": compiled(
            lambda g, m, a: free_run(step, params, g, m, a, *bounds, depth=lags),
            g, measured, anchor,
        ),
        "free_run": compiled(run_record, network, *args),
        "loss_and_gradient": compiled(
            jax.value_and_grad(lambda m, *a: loss(m, run_record, *a)), moving, *args
        ),
    }  # fmt: skip
    if autodiff:
        calls["autodiff"] = compiled(
            jax.value_and_grad(lambda m, *a: loss(m, plain_run, *a)), moving, *args
        )
    times = in_turn(calls, repeats)
    y = calls["loop"]()
    np.savez(
        path,
        g=g,
        table=monomials(network),
        measured=measured,
        anchor=anchor,
        y=y,
        u=u[0],
    )
    found: dict[str, Any] = {"times": times}
    if autodiff:
        ours, theirs = (
            jnp.concatenate([a.reshape(-1) for a in jax.tree.leaves(calls[k]()[1])])
            for k in ("loss_and_gradient", "autodiff")
        )
        scale = jnp.max(jnp.abs(theirs))
        found["gradient_difference"] = float(jnp.max(jnp.abs(ours - theirs)) / scale)
    return found


def run_normal(
    models: int, terms: int, records: int, samples: int, repeats: int
) -> dict[str, Any]:
    """J'J and J'r; a model has its terms' coefficients, 2 centres and 2 widths."""
    import jax
    import jax.numpy as jnp

    from jaxnarx.refinement.gauss_newton import normal_equations
    from jaxnarx.refinement.layout import make_layout

    network = make_network(models, terms)
    drive, anchor, _ = make_records(network, samples, records)
    layout = make_layout(network, None, (0.1, 10.0))
    point, weight = layout.gather(network), jnp.ones_like(drive.measured)
    jax.block_until_ready(drive)
    before, _ = resident()
    call = lambda: normal_equations(layout, point, drive, anchor, weight)  # noqa: E731
    times = in_turn({"normal_equations": call}, repeats)["normal_equations"]
    _, peak = resident()
    return {
        "parameters": int(point.shape[0]),
        "records": records,
        "samples": records * samples,
        "times": times,
        "peak_mb": round(peak / 1e6),
        "above_data_mb": round((peak - before) / 1e6),
    }


def run_search(members: int, samples: int) -> dict[str, Any]:
    """Networks of one capacity, other models and terms used: programs and seconds."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxnarx.simulation import run

    network = make_network(10, 8)
    drive, anchor, _ = make_records(network, samples)
    events: list[float] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        del kwargs
        if event == "/jax/core/compile/backend_compile_duration":
            events.append(duration_secs)

    def member(n: int):
        used = np.random.default_rng(n).random((10, 8)) < 0.7
        active = jnp.asarray(np.arange(10) <= n % 10)
        return eqx.tree_at(
            lambda net: (net.models[0].active, net.models[0].local.used),
            network,
            (active, jnp.asarray(used)),
        )

    networks = [member(n) for n in range(members)]
    jax.clear_caches()
    jax.monitoring.register_event_duration_secs_listener(listen)
    begin = time.perf_counter()
    for one in networks:
        jax.block_until_ready(run(one, drive, anchor))
    return {
        "networks": members,
        "programs": len(events),
        "compiling_s": round(sum(events), 3),
        "seconds": round(time.perf_counter() - begin, 3),
    }


WORKERS: dict[str, Callable[..., dict[str, Any]]] = {
    "model": run_model,
    "normal": run_normal,
    "search": run_search,
}
