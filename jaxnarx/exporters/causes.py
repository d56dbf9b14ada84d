"""Why code in single precision leaves the model."""

from jaxnarx.data import Dataset
from jaxnarx.models import Network
from jaxnarx.refinement import stability

SLOW_POLE = 0.999
"""A pole from which rounding of 1e-7 a sample adds up to more than 1e-4."""
POLE_SAMPLES = 500
"""Samples that poles are looked at."""


def cause(network: Network, data: Dataset) -> str:
    """The cause as far as poles tell it, and what to do."""
    advice = "Use double precision on the target"
    rows = stability(network, data, samples=POLE_SAMPLES).value.poles
    local = [row for row in rows if row.model is not None]
    worst = max(local, key=lambda row: row.median, default=None)
    if worst is None or worst.median < SLOW_POLE:
        return f"{advice}, or scale channels that are much larger than they vary."
    does = "does not forget" if worst.median >= 1 else "hardly forgets"
    return (
        f"Local model {worst.model} of {worst.output} {does} its past (pole "
        f"{worst.median:.4g}), so that rounding adds up. {advice}, or take a model "
        "that contracts: `jaxnarx identify --preset ecu`."
    )
