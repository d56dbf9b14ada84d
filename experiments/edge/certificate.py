"""In search of what contradicts the certificate: a million random input sequences.

One output each of four virtual engines is identified (preset quick) from the records of
`run.py`. Pairs of runs under the same inputs, drawn up to three times the trained
ranges, begin at different outputs; a step that leaves a larger share of their distance,
in the certificate's own norm, than is certified would be a counterexample.

    python experiments/edge/certificate.py [--sequences 1000000]

Results: `experiments/benchmarks/results/edge_certificate.json`.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))
sys.path.insert(0, str(HERE))
from common import record, results_folder  # noqa: E402 # pyright: ignore
from figures import counterexamples  # noqa: E402 # pyright: ignore
from run import INNER, LENGTH, RECORDS, noisy, records  # noqa: E402 # pyright: ignore

OUTPUTS = {"gtdi": "TRQ", "diesel": "x_egr", "vct": "cam", "pfi-dyno": "AFR"}
"""Of every bed one with memory; the cam is a polynomial NARX, its certificate holds
where inputs are held in products."""


def main() -> None:
    """Bed by bed, a share of the sequences each."""
    import jax

    import jaxnarx as jnx

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sequences", type=int, default=1_000_000, help="of all beds")
    parser.add_argument("--results", metavar="DIR", help="folder for the JSON")
    parser.add_argument("--smoke", action="store_true", help="one bed, few sequences")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    beds, length, most = list(OUTPUTS), LENGTH, None
    if options.smoke:
        beds, length, most, options.sequences = ["pfi-dyno"], 400, 3, 20
    figures: dict[str, Any] = {}
    for bed in beds:
        train = noisy(records(bed, INNER, 1, RECORDS, length), 1)
        output = OUTPUTS[bed]
        fit = jnx.identify(train, preset="quick", outputs=[output], candidates=most)
        row = fit.stats["leaderboard"].choose(output)
        own = jnx.Dataset.from_arrays(
            [r.u for r in train],
            [r.y[:, [train.channels.output_names.index(output)]] for r in train],
            inputs=train.channels.inputs,
            outputs=[c for c in train.channels.outputs if c.name == output],
            sample_time=train.sample_time,
        )
        found = counterexamples(fit.value, own, options.sequences // len(beds))
        figures[f"{bed} {output}"] = {"chosen": row.name} | found
        print(bed, figures[f"{bed} {output}"], flush=True)
    folder = results_folder(options.results, smoke=options.smoke)
    record("edge_certificate", figures, folder=folder)


if __name__ == "__main__":
    main()
