"""What is tried on every set: number of states, degree, regions, and pulls.

A short list for each set, likely ones first, since a structure far behind the best is
given up early. Chosen from the training records: of the linear models of one to six
states those with small errors, of the products what so many samples bear.
"""

import math
from collections.abc import Iterator
from typing import Any

FEW = (0.3, 0.1, 0.03, 0.01, 0.001)
"""Pulls towards the linear model where samples are few."""
MANY = (0.1, 0.01, 0.001, 1e-4, 1e-5)
"""Those of longer records."""
SHARE = 5
"""Samples for every coefficient, at least."""
STEPS, FINAL = 40, 100
"""Accepted steps at every pull, and on the whole of long records in the end."""

STRUCTURES: dict[str, tuple[tuple[int, int], ...]] = {
    "cascaded_tanks": ((3, 2), (2, 2), (2, 3), (4, 2), (3, 1), (1, 2), (5, 2)),
    "ced_coupled_drives": ((4, 2), (3, 2), (2, 2), (4, 1), (3, 1), (2, 3), (3, 3)),
    "silverbox": ((2, 3), (3, 3), (2, 2), (2, 1)),
    "bouc_wen_sysidentpy": ((2, 3), (2, 2), (3, 2), (1, 3), (2, 1)),
    "daisy_cstr": ((2, 3), (3, 3), (3, 2), (2, 2), (2, 1)),
    "wiener_hammerstein": ((6, 2), (6, 3)),
}
"""Number of states and degree."""
IN_REGIONS: dict[str, tuple[int, ...]] = {
    "cascaded_tanks": (3, 2, 4),
    "ced_coupled_drives": (3, 4, 2),
    "bouc_wen_sysidentpy": (3, 2, 4),
}
"""Numbers of states tried in two and three regions, of short sets."""
REGIONS, FALLING = 3, (0.1, 0.01, 0.001)
"""Most regions, and the pulls with them."""


def methods(name: str, train: Any, output: str, window: int) -> Iterator[Any]:
    """Methods of one output that its records bear; starts from so many samples."""
    from jaxnarx.settings import HiddenStates

    inputs = len(train.channels.inputs)
    for states, degree in STRUCTURES[name]:
        count = (states + 1) * math.comb(states + inputs + degree, degree)
        if count * SHARE > train.samples:
            continue
        yield HiddenStates(
            outputs=(output,),
            states=states,
            degree=degree,
            shrink=FEW if train.samples < 2000 else MANY,
            window=window,
            max_steps=STEPS,
        )
    for states in IN_REGIONS.get(name, ()):
        count = (states + 1) * (states + inputs + 1)
        regions = min(REGIONS, train.samples // SHARE // count)
        if regions < 2:
            continue
        yield HiddenStates(
            outputs=(output,),
            states=states,
            degree=1,
            regions=regions,
            shrink=FALLING,
            window=window,
            max_steps=STEPS,
        )


def named(method: Any, regions: int | None = None) -> str:
    """`2 states, degree 3`, or `3 states, 2 regions`."""
    regions = method.regions if regions is None else regions
    size = f"degree {method.degree}" if regions == 1 else f"{regions} regions"
    return f"{method.states} states, {size}"
