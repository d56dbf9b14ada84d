"""Linear state-space models to start from, in the order they are tried.

Subspace identification gives what the data ask for; its choice depends on the number of
block rows and on which records take part, so several are made. A chain of equal lags
(`subspace.chain_model`) is what tanks, pipes and heated walls are like.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require_known
from jaxnarx.data import Dataset
from jaxnarx.errors import JaxnarxError
from jaxnarx.linear.state_space.model import StateSpace
from jaxnarx.linear.state_space.subspace import (
    chain_model,
    identify_subspace,
    subspace_models,
)

BLOCK_ROWS = (None, 10, 15)
"""The default of `identify_subspace`, and two that short records bear."""
NEARLY_BEST_FACTOR = 1.05
"""Error of a linear model, over that of the best, that is nearly as good."""


def linear_starts(
    data: Dataset, outputs: Sequence[int], states: int
) -> Iterator[tuple[str, StateSpace]]:
    """Models of so many states with their names; those that cannot be made are left
    out."""
    every = _arrays(data, outputs)
    # Of several records the longest alone: others may have been run otherwise.
    at = int(np.argmax([good.sum() for good in every["valid"]]))
    longest = {name: values[at : at + 1] for name, values in every.items()}
    tried: list[tuple[str, Callable[[], StateSpace]]] = [
        (
            _name_start(rows),
            lambda rows=rows: identify_subspace(order=states, block_rows=rows, **every),
        )
        for rows in BLOCK_ROWS
    ]
    if len(data) > 1:
        tried.append(
            ("longest record", lambda: identify_subspace(order=states, **longest)),
        )
    if len(outputs) == 1:
        tried.append(("chain of lags", lambda: chain_model(order=states, **every)))
    for name, made in tried:
        try:
            yield name, made()
        except (JaxnarxError, np.linalg.LinAlgError):
            continue


@guard_arguments
def linear_order(data: Dataset, output: str, most: int) -> int | None:
    """The fewest states of a linear model nearly as good as the best of up to `most`.

    The criterion is the error of their free runs on the data, within
    `NEARLY_BEST_FACTOR` of the least; None where there is no such model.
    """
    names = data.channels.output_names
    require_known(output, names, "output", f"unknown output {output!r}")
    every = _arrays(data, [names.index(output)])
    try:
        models = subspace_models(orders=range(1, most + 1), **every)
    except JaxnarxError:
        return None
    errors = {n: model.free_run_error(**every) for n, model in models.items()}
    least = min(errors.values())
    return min(
        n for n, error in errors.items() if error <= NEARLY_BEST_FACTOR**2 * least
    )


def _name_start(rows: int | None) -> str:
    return "subspace" if rows is None else f"subspace of {rows} block rows"


def _arrays(data: Dataset, outputs: Sequence[int]) -> dict[str, Any]:
    inputs = len(data.channels.inputs)
    columns = [*range(inputs), *(inputs + o for o in outputs)]
    return {
        "u": [r.u for r in data],
        "y": [r.y[:, list(outputs)] for r in data],
        "valid": [r.valid[:, columns].all(axis=1) for r in data],
    }
