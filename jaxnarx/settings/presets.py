"""How much an automatic identification tries, and how it chooses."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Preset:
    """Limits of a search."""

    text: str
    """Description in a few words."""
    max_models: int = 14
    """Most regions in closed form."""
    degree: int = 2
    """Degree of products of inputs there."""
    grown: int = 4
    """How many of the polynomials are grown."""
    fed_back: int = 6
    """How many candidates with products of past outputs are tried."""
    states: int = 5
    """How many structures with hidden states are tried."""
    orders: tuple[int, ...] = ()
    """Numbers of hidden states that are tried (empty: as the data suggest)."""
    gates: int = 0
    """How many numbers and draws of sigmoid gates are tried, each with one or two
    numbers of hidden states."""
    patience: int = 3
    """After so many methods of a kind, none of which came near the best, the kind is
    given up; not those with hidden states of short records."""
    sums: int = 0
    """Most candidates, each the best of its kind, whose mean is tried."""
    roots: int = 0
    """How many polynomials are grown that model the root of an output far from
    symmetric; 0: none is modelled."""
    smaller: int = 1
    """How many candidates with fewer regions are made again without every group beside
    the chosen one, of long records; of others three."""
    longest: int = 20_000
    """Samples that train those, in stretches of all records: they are trained on the
    free run step by step."""
    longest_bank: int = 120_000
    """Samples that train those that begin as a bank of lags, whose slow states need
    long stretches."""
    rule: str = "near"
    """`near`: the cheapest to compute within one standard error of the best; `share`:
    within 5 %; `best`: the smallest error."""
    linear: bool = False
    """Linear models alone."""

    def with_orders(self, states: int | None) -> "Preset":
        """The preset with hidden states of this number alone; 0 for none, None as it
        stands."""
        if states is None:
            return self
        if not states:
            return dataclasses.replace(self, states=0, gates=0)
        return dataclasses.replace(
            self, orders=(states,), states=max(self.states, 3), patience=3
        )


PRESETS = {
    "quick": Preset(
        "about a minute of processor; no hidden states",
        max_models=6,
        grown=2,
        fed_back=1,
        states=0,
        smaller=0,
        longest=5_000,
        roots=1,
    ),
    "good": Preset("minutes for every output", gates=1, sums=3, roots=2),
    "best": Preset(
        "the smallest error whatever it costs: an hour and more",
        max_models=24,
        grown=5,
        fed_back=16,
        states=10,
        gates=4,
        patience=16,
        sums=3,
        roots=4,
        longest=60_000,
        rule="best",
    ),
    "ecu": Preset(
        "the fewest operations within 5 % of the best, stable for certain",
        max_models=8,
        grown=2,
        fed_back=0,
        states=0,
        rule="share",
    ),
    "linear": Preset("linear models only", linear=True, fed_back=0, states=0),
}
"""Presets by name."""
