"""What stands beside the model of `references.py`: simpler and usual ones.

- `linear ARX`: one affine model, one step ahead;
- `LOLIMOT, one step`: six affine models over speed and load, one step ahead;
- `global polynomial, refined`: 25 terms by error reduction ratio of all products of up
  to three lagged variables, their coefficients refined on the free run;
- `MLP, NARX` and `MLP, NOE`: a perceptron of `WIDTH` units on inputs and inputs through
  first-order lags, trained one step ahead, and from there in free runs.

Terms, coefficients and weights are learned from the training records; where records are
needed to stop, they are those that `hold_out` keeps back from these. No test record
takes part in a choice.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

import jaxnarx as jnx
from jaxnarx.data import hold_out
from jaxnarx.evaluation.cost import cost
from jaxnarx.simulation import Trajectories

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "thesis"))
sys.path.insert(0, str(Path(__file__).resolve().parent))
from neural import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    Budget,
    neural_run,
    neural_size,
    train,
)
from select_terms import (  # noqa: E402 # pyright: ignore[reportMissingImports]
    errors,
    errors_of,
)

BASELINES = (
    "linear ARX",
    "LOLIMOT, one step",
    "global polynomial, refined",
    "MLP, NARX",
    "MLP, NOE",
)
LAGS, OUTPUT_LAGS, TERMS = (0, 1, 2, 4, 8, 16), (1, 2), 25
FILTERS, WIDTH = (1.0, 4.0, 16.0), 12
"""Time constants of the perceptron's inputs [s], and its hidden units."""
SMALL = Budget(adam=20, free_adam=10, bfgs=2, horizons=(10,))
LARGE = Budget(adam=400, free_adam=40, bfgs=40, horizons=(50,))
SHORT = jnx.SimulationError(horizons=(), max_steps=2)
REFINEMENT = jnx.SimulationError(
    horizons=(30, 100, 300, 1000), window_steps=8, max_steps=20, patience=8
)


def sizes(net: jnx.Network) -> dict[str, int]:
    """Parameters, and multiplications of one sample as a control unit does them."""
    one = cost(net, shared=True)
    return {
        "regions": one.local_models,
        "parameters": one.parameters,
        "multiplications": one.multiplications,
        "exponentials": one.exponentials,
    }


def pool_of(data: jnx.Dataset, output: str, degree: int) -> jnx.Pool:
    """Products of lagged inputs and outputs."""
    return jnx.polynomial_pool(
        data.channels,
        outputs=[output],
        input_lags=LAGS,
        output_lags=OUTPUT_LAGS,
        degree=degree,
    )


def one_step(data: jnx.Dataset, output: str, models: int) -> jnx.Network:
    """One affine model, or several over speed and load."""
    method: jnx.Global | jnx.Lolimot = jnx.Global()
    if models > 1:
        method = jnx.Lolimot(scheduling=["speed[t]", "load[t]"], max_models=models)
    return jnx.grow(pool_of(data, output, 1), data, method).value


def polynomial(data: jnx.Dataset, output: str, small: bool) -> jnx.Network:
    """Chosen by error reduction ratio, refined on the free run."""
    fitted, held = hold_out(data)
    pool = pool_of(data, output, 2 if small else 3)
    terms = jnx.select(pool, fitted, jnx.ForwardOLS(max_terms=TERMS)).value
    start = jnx.grow(terms, fitted, jnx.Global()).value
    method = SHORT if small else REFINEMENT
    return jnx.refine(start, fitted, method, validation=held).value


def perceptrons(
    data: jnx.Dataset, test: jnx.Dataset, output: str, small: bool
) -> list[dict[str, Any]]:
    """Rows of both perceptrons; the second starts from the first."""
    fitted, held = hold_out(data)
    pool = jnx.polynomial_pool(
        data.channels,
        outputs=[output],
        input_lags=(0,),
        output_lags=OUTPUT_LAGS,
        degree=1,
        filters=[jnx.LowPass(tau) for tau in FILTERS],
    )
    models = train(
        *(pool, fitted),
        validation=held,
        width=WIDTH,
        key=jax.random.key(0),
        budget=SMALL if small else LARGE,
    )
    (o,) = pool.outputs

    def judged(model) -> dict[str, Any]:
        def run(mode: str) -> Callable[[jnx.Dataset], Trajectories]:
            return lambda d: neural_run(model, d, one_step=mode == "one_step")

        return {m: errors_of(run(m)(test), o, test) for m in ("one_step", "free_run")}

    return [
        {
            "output": output,
            "kind": f"MLP, {kind}",
            "size": neural_size(model),
            "test": judged(model),
        }
        for kind, model in models.items()
    ]


def baseline(
    data: jnx.Dataset, test: jnx.Dataset, output: str, kind: str, small: bool
) -> list[dict[str, Any]]:
    """The rows of one kind; both perceptrons come together."""
    if kind in BASELINES[3:]:
        return perceptrons(data, test, output, small)
    made = {
        BASELINES[0]: lambda: one_step(data, output, 1),
        BASELINES[1]: lambda: one_step(data, output, 6),
        BASELINES[2]: lambda: polynomial(data, output, small),
    }
    net = made[kind]()
    row = {"output": output, "kind": kind, "size": sizes(net)}
    return [row | {"test": errors(net, test)}]
