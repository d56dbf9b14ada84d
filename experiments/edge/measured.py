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
import json
import sys
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
sys.path.insert(0, str(HERE))
from common import code, record, results_folder  # noqa: E402 # pyright: ignore
from figures import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    counterexamples,
    ran_wild,
    tested,
    wild,
)

DESCRIPTION = HERE.parent / "gengine1" / "gengine1.toml"
WILD, WILD_ROWS = 1000, 600
SEQUENCES = 1_000_000
"""Random input sequences."""


def main() -> None:
    """Identify or take what is there, score, record."""
    import jax

    import jaxnarx as jnx
    from jaxnarx.evaluation import cost
    from jaxnarx.exporters import lower

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
    preset, most = options.preset, None
    if options.smoke:
        train, test = small(train, 4), small(test, 1)
        preset, most = "linear", 3
        options.wild, options.sequences = 2, 10
    where = options.search
    network = jnx.identify(train, preset=preset, candidates=most, folder=where).value
    folder = results_folder(options.results, smoke=options.smoke)
    path = folder / "edge_measured.json"
    figures = json.loads(path.read_text())["figures"] if path.exists() else {}
    past = figures.get(preset, {}).get("scored", [])
    step = cost(network).operations
    indexed = lower(network).operations
    found: dict[str, Any] = {
        "test": tested(network, test, train),
        "operations": {
            "step": step,
            "index": indexed - step,
            "intervals": lower(network, level=0.9).operations - indexed,
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
