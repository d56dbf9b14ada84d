"""How much an automatic identification tries."""

import dataclasses

from jaxnarx.checks import choice


@dataclasses.dataclass(frozen=True)
class Preset:
    """Limits of a search. Times are for one output on two cores."""

    max_models: int
    """Most regions."""
    degree: int
    """Of products of inputs in the closed form."""
    grown: int
    """How many kinds of feedback are grown."""
    fed_back: int
    """How many candidates with products of past outputs are tried; they are trained on
    the free run step by step, which long records make slow."""
    longest: int
    """Samples beyond which those are left out."""
    budget: float
    """Seconds for all outputs together, beyond which no further candidate is begun."""
    rule: str
    """`near`: the cheapest to compute within one standard error of the best; `share`:
    within 5 %; `best`."""
    linear: bool = False
    """Linear models alone."""


PRESETS = {
    "quick": Preset(6, 2, 1, 3, 20_000, 120.0, "near"),
    "good": Preset(14, 2, 2, 10, 60_000, 3600.0, "near"),
    "best": Preset(24, 3, 3, 16, 400_000, 14_400.0, "best"),
    "ecu": Preset(8, 2, 1, 0, 0, 3600.0, "share"),
    "linear": Preset(1, 1, 0, 0, 0, 600.0, "near", linear=True),
}
"""By name."""


def preset_of(name: str) -> Preset:
    """A preset; SpecError where there is none of that name."""
    choice(name, tuple(PRESETS), "preset")
    return PRESETS[name]
