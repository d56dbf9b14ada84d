"""A measured engine at the edge of what its models know: the eight outputs of gengine1.

Models are those of `jaxnarx identify` (`experiments/gengine1/identify.py`, whose folder
of a search is used if it is there). On the six test records, which took no part in any
choice: rank correlation of the index of the domain with the absolute free-run error,
samples outside, and what 90 % intervals hold, in the whole and by thirds of the output
and of every input in use. On records that nobody would drive (steps, ramps and noise up
to three times the trained ranges): runs that are not finite or diverge. And of the
certificate: pairs of runs from different starts over a million random input sequences,
in search of one in which they approach more slowly than it says.

    python experiments/edge/measured.py [--preset good] [--search FOLDER]

Results: `experiments/benchmarks/results/edge_measured.json`.
"""

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
sys.path.insert(0, str(HERE))
from common import code, record, results_folder  # noqa: E402 # pyright: ignore
from run import correlation, ran_wild, wild  # noqa: E402 # pyright: ignore

DESCRIPTION = HERE.parent / "gengine1" / "gengine1.toml"
LEVEL = 0.9
WILD, WILD_ROWS = 1000, 600
SEQUENCES, STEPS, AT_ONCE = 1_000_000, 40, 5_000
"""Random input sequences, their samples, and how many run at a time."""
SEED = 5


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
        o = network.modelled[k]
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


def main() -> None:
    """Identify or take what is there, score, record."""
    import jax

    import jaxnarx as jnx
    from jaxnarx.evaluation import cost

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", default="good")
    parser.add_argument("--search", type=Path, help="folder of a search")
    parser.add_argument("--wild", type=int, default=WILD)
    parser.add_argument("--sequences", type=int, default=SEQUENCES)
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="one output, few samples")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    split = jnx.read_split(DESCRIPTION)
    assert split.train is not None and split.test is not None
    train, test = split.train, split.test
    preset, limits = options.preset, {}
    if options.smoke:
        train, test = small(train, 4), small(test, 1)
        preset, limits = "linear", {"candidates": 3}
        options.wild, options.sequences = 2, 10
    network = jnx.identify(train, preset=preset, folder=options.search, **limits).value
    folder = results_folder(options.results, smoke=options.smoke)
    path = folder / "edge_measured.json"
    figures = json.loads(path.read_text())["figures"] if path.exists() else {}
    past = figures.get(preset, {}).get("scored", [])
    domain, errors = network.domain, network.errors
    assert domain is not None and errors is not None
    found: dict[str, Any] = {
        "test": tested(network, test, train),
        "operations": {
            "step": sum(sum(part.values()) for part in _price(cost(network))),
            "index": domain.operations,
            "intervals": errors.operations,
        },
        "outside": network.outside,
    }
    print(json.dumps(found, indent=1), flush=True)
    found["wild"] = {
        policy: ran_wild(
            jnx.models.hold_to_range(network, outside=policy),
            wild(network, train, options.wild, WILD_ROWS),
        )
        for policy in ("flag", "hold", "linear")
    }
    print(found["wild"], flush=True)
    found["certificate"] = counterexamples(network, train, options.sequences)
    print(found["certificate"], flush=True)
    when = code() | {"date": time.strftime("%Y-%m-%d")}
    figures[preset] = found | {"scored": [*past, when]}
    record("edge_measured", figures, folder=folder)


def _price(price: Any) -> list[dict[str, int]]:
    """Operations of a step by part."""
    return [
        {k: v for k, v in dataclasses.asdict(part).items() if isinstance(v, int)}
        for part in (price.terms, price.weights, price.blend, price.filters)
    ]


def small(data: Any, records: int) -> Any:
    """Some records, a thousand samples of each, one output."""
    import jaxnarx as jnx

    some = list(data)[:records]
    return jnx.Dataset.from_arrays(
        [r.u[:1000] for r in some],
        [r.y[:1000, 6:7] for r in some],
        inputs=data.channels.input_names,
        outputs=data.channels.output_names[6:7],
        sample_time=data.sample_time,
        names=[r.name for r in some],
    )


if __name__ == "__main__":
    main()
