"""What a network does at the edge of what it knows: figures of both experiments.

Wild records, rank correlation, what intervals hold in the whole and by thirds, and the
search for a counterexample to the certificate.
"""

import dataclasses
from typing import Any

LEVEL = 0.9
WILD = 3.0
"""Reach of wild records, in trained half widths around the middle."""
SETTLED = 60
"""Samples after which a run counts: it starts from the truth."""
SEED = 21
STEPS, AT_ONCE = 40, 5_000
"""Samples of a sequence that is to contradict the certificate, and how many run at a
time."""


def wild(network: Any, like: Any, count: int, rows: int) -> Any:
    """Records of steps, ramps and noise, alone and mixed, up to `WILD` times the
    trained ranges."""
    import numpy as np

    random = np.random.default_rng(SEED)
    inputs = len(network.channels.inputs)
    low, high = (np.asarray(a, float)[:inputs] for a in (network.low, network.high))
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    made = []
    for n in range(count):
        first = like.records[n % len(like)]
        pace = random.integers(5, 120, inputs)
        steps = np.stack(
            [
                np.repeat(random.uniform(-WILD, WILD, rows // p + 1), p)[:rows]
                for p in pace
            ],
            axis=1,
        )
        knots = random.uniform(-WILD, WILD, (7, inputs))
        at = np.linspace(0, 6, rows)
        ramps = np.stack([np.interp(at, range(7), k) for k in knots.T], axis=1)
        noise = random.uniform(-WILD, WILD, (rows, inputs))
        unit = (steps, ramps, noise, (steps + ramps + noise) / 3)[n % 4]
        u = middle[None] + half[None] * unit
        u[:SETTLED] = first.u[:SETTLED]
        y = np.tile(first.y[:1], (rows, 1))
        y[:SETTLED] = first.y[:SETTLED]
        valid = np.ones((rows, u.shape[1] + y.shape[1]), bool)
        made.append(dataclasses.replace(first, u=u, y=y, valid=valid, name=f"wild {n}"))
    return dataclasses.replace(like, records=tuple(made))


def ran_wild(network: Any, data: Any) -> dict[str, Any]:
    """What free runs of these records did."""
    import numpy as np

    import jaxnarx as jnx

    run = jnx.simulate(network, data).value
    return {
        "records": len(data),
        "not finite": int(sum(not np.all(np.isfinite(y)) for y in run.outputs)),
        "diverged": int(sum(bool(d.any()) for d in run.diverged)),
    }


def correlation(index: Any, error: Any) -> float:
    """Of ranks (Spearman)."""
    from scipy.stats import spearmanr

    value: Any = spearmanr(index, error)
    return round(float(value.statistic), 3)


def thirds(by: Any, inside: Any) -> list[float | None]:
    """Share that is held in each third of the samples by a variable."""
    import numpy as np

    third = np.digitize(by, np.quantile(by, [1 / 3, 2 / 3]))
    parts = [inside[third == k] for k in range(3)]
    return [round(float(p.mean()), 3) if len(p) else None for p in parts]


def tested(network: Any, data: Any, training: Any) -> dict[str, Any]:
    """Every output on the test records: index, correlation, intervals."""
    import numpy as np

    import jaxnarx as jnx

    found = jnx.intervals(network, data, level=LEVEL).value
    known = jnx.domain(network, data).value
    index = np.concatenate(known.index)
    u = np.concatenate([r.u for r in data])
    names = network.channels.input_names
    rows, pools = {}, []
    for k, name in enumerate(network.output_names):
        o = data.channels.output_names.index(name)
        y = np.concatenate([r.y[:, o] for r in data])
        s = np.concatenate([scored[:, k] for scored in found.scored])
        low, high, run = (
            np.concatenate([part[:, k] for part in parts])
            for parts in (found.lower, found.upper, found.run.outputs)
        )
        inside = ((y >= low) & (y <= high))[s]
        error = np.abs(y - run)[s]
        spread = float(np.concatenate([r.y[:, o] for r in training]).std())
        pools.append((index[s], error / spread, error / np.median(error)))
        rows[name] = {
            "held": round(float(inside.mean()), 3),
            "half width": round(float(np.mean((high - low)[s]) / 2 / spread), 4),
            "error": round(float(np.sqrt(np.mean(error**2)) / spread), 4),
            "by third of the output": thirds(run[s], inside),
            "by third of an input": {
                channel: thirds(u[s, names.index(channel)], inside)
                for channel in known.channel_names
            },
            "by record": [
                round(
                    float(((r.y[:, o] >= a[:, k]) & (r.y[:, o] <= b[:, k])).mean()), 3
                )
                for r, a, b in zip(data, found.lower, found.upper, strict=True)
            ],
            "spearman": correlation(index[s], error),
        }
    parts = [np.concatenate(part) for part in zip(*pools, strict=True)]
    return {
        "outputs": rows,
        "outside": round(known.outside, 4),
        "spearman": correlation(parts[0], parts[1]),
        "spearman, errors in their median": correlation(parts[0], parts[2]),
        "held": round(float(np.mean([row["held"] for row in rows.values()])), 3),
    }


def counterexamples(network: Any, like: Any, count: int) -> dict[str, Any]:
    """Pairs of runs with the same inputs, drawn up to three times the ranges: the
    largest share of their distance that a step has left, beside what is certified."""
    import numpy as np

    import jaxnarx as jnx
    from jaxnarx.refinement import rate_of

    rate = rate_of(network)
    if not rate < 1:
        return {"certified": None}
    factor, gain = np.asarray(network.certificate), np.asarray(network.gain)
    own, inputs = list(network.signals), len(network.channels.inputs)
    low, high = (np.asarray(a)[:inputs] for a in (network.low, network.high))
    depth = len(factor) // len(own)
    rng, worst, tried = np.random.default_rng(SEED), 0.0, 0
    y_low, y_high = (np.asarray(a)[inputs:] for a in (network.low, network.high))
    first, length = network.history, network.history + STEPS
    while tried < count:
        many = min(AT_ONCE, count - tried)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        hold = rng.integers(1, 20)
        draws = rng.uniform(-3, 3, (many, length // hold + 1, inputs))
        u = middle + half * np.repeat(draws, hold, axis=1)[:, :length]
        runs = []
        for _ in range(2):
            y = np.zeros((many, length, len(y_low)))
            y[:, :first] = rng.uniform(y_low, y_high, (many, first, len(y_low)))
            data = jnx.Dataset.from_arrays(
                list(u),
                list(y),
                inputs=network.channels.input_names,
                outputs=network.channels.output_names,
                sample_time=float(network.sample_time),
            )
            runs.append(np.stack(jnx.simulate(network, data).value.computed))
        gap = (runs[0] - runs[1]) / gain[own]
        state = np.concatenate(
            [gap[:, depth - 1 - d : length - d] for d in range(depth)], axis=2
        )
        size = np.linalg.norm(state @ factor.T, axis=2)[:, max(first - depth, 0) :]
        # Distances near the rounding of the outputs tell nothing.
        there = size[:, :-1] > 1e-6 * size.max()
        worst = max(worst, float((size[:, 1:] / size[:, :-1])[there].max()))
        tried += many
    return {
        "certified": rate,
        "sequences": tried,
        "largest share left by a step": worst,
        "counterexamples": int(worst > rate * (1 + 1e-6)),
    }
