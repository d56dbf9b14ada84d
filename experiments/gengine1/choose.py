"""Choose a configuration for gengine1 by a fixed rule, without the test records.

The rule: of the grid below, for each output, the configuration with the smallest
free-run loss on the records held out of training by `hold_out`, none of them diverging;
ties within 1 % go to the one with fewer parameters. The test records are never scored
here; score the chosen configuration once, by `jaxnarx identify` with its flags.

Run as `python experiments/gengine1/choose.py [--out FILE] [--smoke]`.
"""

import argparse
import json
from pathlib import Path

import jax

import jaxnarx as jnx
from jaxnarx.data import hold_out

OUTPUTS = ("NOx", "T_exhaust")
# (degree, terms, models)
GRID = ((1, 12, 1), (2, 25, 1), (3, 25, 1), (1, 12, 4), (1, 12, 6), (1, 16, 6))
SCHEDULING = ("speed[t]", "load[t]")
INPUT_LAGS, OUTPUT_LAGS = (0, 1, 2, 4, 8, 16), (1, 2)
DESCRIPTION = Path(__file__).with_name("gengine1.toml")


def fit(train, validate, output: str, degree: int, terms: int, models: int) -> dict:
    """Validation figures of one configuration, command line defaults elsewhere."""
    pool = jnx.polynomial_pool(
        train.channels,
        outputs=[output],
        input_lags=INPUT_LAGS,
        output_lags=OUTPUT_LAGS,
        degree=degree,
    )
    chosen = jnx.select(pool, train, jnx.ForwardOLS(max_terms=terms)).value
    local = jnx.Lolimot(scheduling=SCHEDULING, max_models=models)
    grown = jnx.grow(chosen, train, local if models > 1 else jnx.Global()).value
    solution = jnx.refine(grown, train, validation=validate)
    run = jnx.simulate(solution.value, validate)
    return {
        "output": output,
        "degree": degree,
        "terms": terms,
        "models": models,
        "validation": float(solution.stats["loss"]),
        "parameters": int(solution.stats["parameters"]),
        "diverged": run.status_name == "diverged",
        "status": solution.status_name,
    }


def best(rows: list[dict]) -> dict | None:
    """The rule of the module's docstring; None where every configuration diverges."""
    sound = [row for row in rows if not row["diverged"]]
    if not sound:
        return None
    limit = 1.01 * min(row["validation"] for row in sound)
    near = [row for row in sound if row["validation"] <= limit]
    return min(near, key=lambda row: row["parameters"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default=str(Path(__file__).with_name("choice.json")))
    parser.add_argument("--smoke", action="store_true", help="one small fit")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    train = jnx.read_split(DESCRIPTION).train
    assert train is not None
    if options.smoke:
        train = train[[9, 19, 8, 18]]
    train, validate = hold_out(train)
    grid = GRID[:1] if options.smoke else GRID
    outputs = OUTPUTS[:1] if options.smoke else OUTPUTS
    result: dict = {"held_out": validate.names, "rows": [], "chosen": {}}
    for output in outputs:
        rows = [fit(train, validate, output, *setting) for setting in grid]
        result["rows"] += rows
        result["chosen"][output] = best(rows)
        Path(options.out).write_text(json.dumps(result, indent=1, allow_nan=False))


if __name__ == "__main__":
    main()
