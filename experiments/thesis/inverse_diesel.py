"""The sign reversal of the `diesel` bed's turbine, found in an identified model.

Closing the turbine (VGT) lifts the compressor flow where it is open and lowers it where
it is nearly shut and the EGR valve open: the gain passes zero, and the same flow has
two positions of the turbine. A network of the flow is identified at 0.1 s under the
bed's usual excitation; `invertible` looks at its static gain. The bed's own gain, by
the derivative of its steady state at the same operating points, says whether it is
right. The intake pressure stands beside it, whose gain keeps its sign on the bed: what
is found there is a false alarm.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from inverse_models import judged

import jaxnarx as jnx
from jaxnarx.engines import Diesel, records
from jaxnarx.inverse import Region

LENGTH, TERMS = 3000, 40
PARTS = ("identification", "validation", "test")
TARGETS, COMMAND = ("W_c", "p_im"), "VGT"
LAGS = (1, 2, 3, 5, 8, 13, 21)
STEPS = jnx.SimulationError(
    horizons=(30, 100), window_steps=8, max_steps=15, patience=6
)


def network_of(train: jnx.Dataset, guard: jnx.Dataset, smoke: bool) -> jnx.Network:
    """Flow or pressure by cubic terms of ERR, refined."""
    pool = jnx.polynomial_pool(
        train.channels, input_lags=LAGS, output_lags=(1, 2), degree=2 if smoke else 3
    )
    few = 10 if smoke else TERMS
    terms = jnx.select(pool, train, jnx.ForwardOLS(max_terms=few)).value
    start = jnx.grow(terms, train, jnx.Global()).value
    if smoke:
        return start
    return jnx.refine(start, train, STEPS, validation=guard).value


@eqx.filter_jit
def true_gains(engine: Diesel, target: str, inputs: Any) -> Any:
    """Static gain of VGT on the target at rest under `inputs`, a % of VGT."""
    outputs = [c.name for c in engine.channels.outputs]
    column = [c.name for c in engine.channels.inputs].index(COMMAND)
    at = outputs.index(target)

    def flow(u):
        return engine.steady_outputs(u)[at]

    return jax.lax.map(lambda u: jax.jacfwd(flow)(u)[column], inputs)


def reversal(seed: int, smoke: bool = False) -> list[dict[str, Any]]:
    """What `invertible` says of models of this seed, and whether the bed agrees."""
    length = 600 if smoke else LENGTH
    data = records(
        *(Diesel(), jax.random.key(seed), [length] * 3),
        names=PARTS,
        outputs=TARGETS,
    )
    return [found_in(only(data, target), target, smoke) for target in TARGETS]


def only(data: jnx.Dataset, target: str) -> jnx.Dataset:
    """The same records with one output."""
    at = data.channels.output_names.index(target)
    return jnx.Dataset.from_arrays(
        [r.u for r in data],
        [r.y[:, at : at + 1] for r in data],
        inputs=list(data.channels.inputs),
        outputs=[data.channels.outputs[at]],
        sample_time=data.sample_time,
        names=data.names,
    )


def found_in(data: jnx.Dataset, target: str, smoke: bool) -> dict[str, Any]:
    """The findings on one output, gains of model and bed, and their agreement."""
    network = network_of(data[:1], data[1:2], smoke)
    points = 50 if smoke else 400
    found = jnx.inverse.invertible(
        network, data[2:], commands=[COMMAND], targets=[target], points=points
    )
    value = found.value
    gain = value.gain[:, 0, 0]
    inputs = value.place[:, : len(data.channels.inputs)]
    true = np.asarray(true_gains(Diesel(), target, jnp.asarray(inputs)))
    known = np.isfinite(gain) & np.isfinite(true)
    gain, true = gain[known], true[known]
    named = list(zip(value.findings, value.regions, strict=True))
    reversals = [r for f, r in named if f.kind == "gain_reversal"]
    return {
        "target": target,
        "status": found.status_name,
        "findings": [
            {"severity": f.severity, "kind": f.kind, "message": f.message}
            for f in value.findings
        ],
        "reversal": bool(reversals),
        "region": described(reversals[0]) if reversals and reversals[0] else None,
        "positive": float(np.mean(gain > 0)),
        "positive_true": float(np.mean(true > 0)),
        "agreement": float(np.mean((gain > 0) == (true > 0))),
        "agreement_clear": agreement(gain, true),
        "nrmse": errors(network, data[2:]),
        "points": int(known.sum()),
        "gain": gain,
        "true": true,
        "place": inputs[known],
    }


def errors(network: jnx.Network, test: jnx.Dataset) -> dict[str, float]:
    """NRMSE on the unseen record: persistence, one step ahead and in the free run."""
    found = judged(network, test)
    return {
        mode: one[test.channels.output_names[0]]["nrmse"] for mode, one in found.items()
    }


def agreement(gain: np.ndarray, true: np.ndarray, least: float = 0.25) -> float:
    """Share of equal signs where the true gain is above a quarter of its median."""
    clear = np.abs(true) > least * np.median(np.abs(true))
    return float(np.mean((gain > 0)[clear] == (true > 0)[clear]))


def described(region: Region) -> dict[str, Any]:
    return {
        "channel": region.channel,
        "above": region.above,
        "border": region.border,
        "agreement": region.agreement,
        "also": None if region.also is None else described(region.also),
    }
