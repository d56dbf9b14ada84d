"""What a report says about stability."""

from typing import Any

from jaxnarx.data import Dataset
from jaxnarx.models import Network
from jaxnarx.solution import Solution

SAMPLES = 2000
"""Samples a report looks at, evenly spaced: it should not take longer than the runs."""


def assess(network: Any, data: Dataset, free: Any) -> Any:
    """The `Stability` of a network on `data`; None for what is no `Network`.

    `free` is the free run at hand: what `simulate` returned, else it is run again.
    """
    if not isinstance(network, Network):
        return None
    # Inside the function: refinement stands above `evaluation.metrics`, so that an
    # import of this folder must not need it.
    from jaxnarx.refinement.stability import stability

    simulated = free if isinstance(free, Solution) else None
    return stability(network, data, samples=SAMPLES, simulated=simulated).value


def stability_notes(value: Any, part: str) -> list[str]:
    """Whether and how fast the model forgets its past, or where it does not."""
    return [] if value is None else [f"Stability on {part}: {value.summary}"]


def stability_values(value: Any) -> dict[str, Any] | None:
    """Poles, bounds and the verdict as plain values."""
    if value is None:
        return None
    return {
        "contracts": value.contracts,
        "time_constant": value.time_constant,
        "summary": value.summary,
        "poles": value.poles,
        "bounds": value.bounds,
    }
