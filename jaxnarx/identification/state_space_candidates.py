"""Candidates with hidden states, each trained on the free run."""

import math
from collections.abc import Iterator

from jaxnarx.data import Dataset, thin_records
from jaxnarx.linear import linear_order
from jaxnarx.settings import HiddenStates, Preset

FAMILY_NAME = "hidden states"
FEW_INPUTS = ((2, 3), (3, 2), (4, 2), (3, 3), (2, 2), (4, 3), (5, 2), (6, 2), (8, 2))
MANY_INPUTS = ((2, 2), (3, 2), (1, 2), (4, 2), (2, 3), (5, 2))
FEW_SAMPLES = ((2, 2), (2, 3), (3, 2), (4, 2), (1, 2), (3, 3), (5, 2))
"""Number of states and degree, in the order they are tried: of one or two inputs, of
more, and of short records."""
IN_REGIONS, REGION_STATES = (3, 2, 4), 3
"""Numbers of states tried in up to so many regions, on short records, in turn with
products: a training step takes several times as long."""
UNASKED_INPUTS = 2
"""Inputs up to which they are tried unasked, on long records products of three factors
first."""
PULLS_TRIED = 0.1, 0.01, 0.001
SHORT_RECORDS, SHORT_PULLS = 2000, (0.3, *PULLS_TRIED)
"""Samples up to which a training begins with a stronger one: of the cascaded tanks'
1,024 it makes the best model with hidden states."""
MOST_COEFFICIENTS = 600
"""Coefficients of a candidate: of 840 (Wiener-Hammerstein, six states, degree three) it
took longer than all others together."""
SAMPLES_PER_COEFFICIENT = 6
"""Samples for each coefficient."""
MOST_LINEAR_STATES = 6
"""Most states of the linear models that are looked at."""
SEARCH_SAMPLES = 10_000
"""Samples, in stretches of all records, of that look."""
GATED_FAMILY = "sigmoid states"
GATES_TRIED = (8, 1), (4, 1), (8, 2), (4, 2)
"""Numbers of sigmoid gates, and of their draws."""
GATE_PULLS = 0.1, 0.01, 0.001, 1e-4
"""Pulls with gates, which are bounded and need less of it."""
STEPS_PER_PULL = 25
"""Accepted steps at each pull."""
WINDOW_SHARE, WINDOW_LIMITS = 40, (10, 50)
"""The window that starts are estimated from: this part of the shortest record, but not
less and not more samples than these."""


def propose_state_space(
    data: Dataset, output: str, preset: Preset
) -> Iterator[tuple[str, list[str], HiddenStates]]:
    """(family, names, method), those that pay most often first.

    The first has as many states as a linear model asks for. One method makes a
    candidate for every pull towards the linear model, and for every number of regions.
    """
    low, high = WINDOW_LIMITS
    window = min(max(min(map(len, data)) // WINDOW_SHARE, low), high)
    for states, degree, regions in _structures(data, output, preset):
        short = data.samples <= SHORT_RECORDS and regions == 1
        method = HiddenStates(
            outputs=(output,),
            states=states,
            degree=degree,
            regions=regions,
            shrink=SHORT_PULLS if short else PULLS_TRIED,
            window=window,
            max_steps=STEPS_PER_PULL,
        )
        names = [
            f"{states} states, "
            + (f"degree {degree}" if r == 1 else f"{r} regions")
            + f", pull {pull:g}"
            for r, pull in method.stages
        ]
        yield FAMILY_NAME, names, method


def propose_gates(
    data: Dataset, output: str, preset: Preset
) -> Iterator[tuple[str, list[str], HiddenStates]]:
    """(family, names, method) of sigmoid states, those with few gates first.

    On the cascaded tanks, the coupled drives and the Bouc-Wen damper 2 of 64 gated
    candidates diverged on a group left out, of those with products 13 of 20; on the
    damper errors there fell with the pull, to .061 with eight gates against .075 of
    products.
    """
    states = preset.orders
    if not states:
        found = linear_order(
            thin_records(data, SEARCH_SAMPLES), output, MOST_LINEAR_STATES
        )
        usual = (3, 2) if found is None else (found, 3, 2)
        states = tuple(dict.fromkeys(usual))
    low, high = WINDOW_LIMITS
    most = min(MOST_COEFFICIENTS, data.samples / SAMPLES_PER_COEFFICIENT)
    for gates, draw in GATES_TRIED:
        for n in states:
            variables = 1 + n + len(data.channels.inputs)
            if (n + 1) * (variables + gates) + gates * variables > most:
                continue
            method = HiddenStates(
                outputs=(output,),
                states=n,
                degree=1,
                gates=gates,
                draw=draw,
                shrink=GATE_PULLS,
                window=min(max(min(map(len, data)) // WINDOW_SHARE, low), high),
                max_steps=STEPS_PER_PULL,
            )
            lead = f"{n} states, {gates} gates, draw {draw}"
            names = [f"{lead}, pull {pull:g}" for _, pull in method.stages]
            yield GATED_FAMILY, names, method


def _structures(
    data: Dataset, output: str, preset: Preset
) -> Iterator[tuple[int, int, int]]:
    """Number of states, degree, most regions; nothing is looked at before the first is
    wanted."""
    most, inputs = (
        min(MOST_COEFFICIENTS, data.samples / SAMPLES_PER_COEFFICIENT),
        len(data.channels.inputs),
    )

    def most_regions(states: int, degree: int) -> int:
        """Regions that the data bear."""
        count = (states + 1) * math.comb(states + inputs + degree, degree)
        return int(most / count)

    states = preset.orders or IN_REGIONS
    sizes = ((n, min(most_regions(n, 1), REGION_STATES)) for n in states)
    in_regions = (size for size in sizes if size[1] > 1)
    for n, degree in _products(data, output, preset):
        if not most_regions(n, degree):
            continue
        yield n, degree, 1
        size = next(in_regions, None) if data.samples <= SHORT_RECORDS else None
        if size is not None:
            yield size[0], 1, size[1]


def _products(data: Dataset, output: str, preset: Preset) -> Iterator[tuple[int, int]]:
    """Number of states and degree."""
    few, short = (
        len(data.channels.inputs) <= UNASKED_INPUTS,
        data.samples <= SHORT_RECORDS,
    )
    if not (few or preset.orders or preset.rule == "best"):
        # On virtual engines none came near the closed form, at minutes for each; on the
        # 1,600 samples of the Bouc-Wen damper blocks left out promised half the error.
        return
    degrees = (3, 2) if few and not short else (2, 3)
    if preset.orders:
        yield from ((n, degree) for n in preset.orders for degree in (*degrees, 1))
        return
    usual = FEW_SAMPLES if short else FEW_INPUTS if few else MANY_INPUTS
    n = linear_order(thin_records(data, SEARCH_SAMPLES), output, MOST_LINEAR_STATES)
    own = () if n is None else ((n, degree) for degree in degrees)
    yield from dict.fromkeys([*own, *usual])
