"""Candidates with hidden states, each trained on the free run."""

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from jaxnarx.data import Dataset, thin_records
from jaxnarx.linear import linear_order
from jaxnarx.partition import DataProfile
from jaxnarx.settings import HiddenStates, Preset

FAMILY_NAME = "hidden states"
FEW_INPUTS = ((2, 3), (3, 2), (4, 2), (3, 3), (2, 2), (4, 3), (5, 2), (6, 2), (8, 2))
MANY_INPUTS = ((2, 2), (3, 2), (1, 2), (4, 2), (2, 3), (5, 2))
FEW_SAMPLES = ((2, 2), (2, 3), (3, 2), (4, 2), (1, 2), (3, 3), (5, 2))
"""Number of states and degree, in the order they are tried: of one or two inputs, of
more, and of short records, behind those that a linear model asks for."""
MOST_REGIONS, REGION_STATES = 3, 4
"""Most regions, and most states in them, on short records, in turn with products: a
training step takes several times as long. Of the cascaded tanks and the coupled drives
the best have as many states as a linear model asks for, or one less."""
UNASKED_INPUTS = 2
"""Inputs up to which they are tried unasked, on long records products of three factors
first."""
PULLS_TRIED = 0.1, 0.01, 0.001
SHORT_RECORDS, SHORT_PULLS = 2000, (0.3, *PULLS_TRIED)
"""Samples up to which a training begins with a stronger one: of the cascaded tanks'
1,024 it makes the best model with hidden states."""
SHORT_SATURATION = 3.0
"""Standard deviations at which states with products saturate on short records. On
blocks left out of the cascaded tanks, of two states and degree two, .088 in place of
.148, on the coupled drives .23 where they diverge without, on the Bouc-Wen damper .071
for .075. On 3,750 samples of a stirred tank it is worse, .0094 for .0080; regions need
none."""
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
"""Numbers of sigmoid gates, and of their draws; the first so many of a preset."""
BANK_GATES_TRIED = (8, 1), (12, 1), (8, 2), (12, 2)
"""... of those that begin as a bank of lags."""
BANK_STATES, BANK_FACTOR, FASTEST_SAMPLES = 4, 4.5, 0.5
"""Most time constants of such a bank, how far they are apart, and the fastest one
[samples], below that of the least memory that is found."""
SETTLING_TIMES = 7.0
"""Time constants after which an answer is over."""
BANK_LAG = 40
"""Samples of input history of such a bank, at most about."""
STRETCH_TIMES = 20
"""Length of a stretch that trains, in slowest time constants: trained
on some 600 samples each, runs of 12 of 16 whole records of an engine diverged."""
LONG_RECORDS, LONG_BANK_PULLS, LONG_BANK_STEPS = 20_000, (0.001,), 10
"""Samples beyond which one pull and few steps are enough for a bank of lags ..."""
FIRST_ROWS, LONG_FIRST_ROWS = 3_000, 120_000
FIRST_STEPS, LONG_FIRST_STEPS = 12, 40
"""... after first steps, on so many samples."""
GATE_PULLS, LONG_GATE_PULLS = (0.1, 0.01, 0.001, 1e-4), (0.001, 1e-5, 1e-7)
"""Pulls with gates, which are bounded and need less of it; those of long records
without a bank."""
GATE_RIDGE, LONG_GATE_RIDGE, LONG_GATE_STEPS = 1e-4, 1e-7, 40
"""Their ridge, and steps at each pull of the latter. On a group left out of the
Wiener-Hammerstein circuit six states and eight gates erred by 1.2 mV with the larger
ridge, .28 to .39 with the smaller one; on 1,600 samples of the Bouc-Wen damper the
larger one was better, .034 for .063."""
FEW_GATED_STATES = 3
"""States where no linear model says how many."""
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
    window = _window(data)
    for states, degree, regions in _structures(data, output, preset):
        short = data.samples <= SHORT_RECORDS and regions == 1
        saturation = SHORT_SATURATION if short and degree > 1 else 0.0
        method = HiddenStates(
            outputs=(output,),
            states=states,
            degree=degree,
            regions=regions,
            shrink=SHORT_PULLS if short else PULLS_TRIED,
            window=window,
            saturation=saturation,
            max_steps=STEPS_PER_PULL,
        )
        stays = f", saturated at {saturation:g}" if saturation else ""
        names = [
            f"{states} states, "
            + (f"degree {degree}" if r == 1 else f"{r} regions")
            + f"{stays}, pull {pull:g}"
            for r, pull in method.stages
        ]
        yield FAMILY_NAME, names, method


def propose_gates(
    data: Dataset, profile: DataProfile, preset: Preset
) -> Iterator[tuple[str, list[str], HiddenStates]]:
    """(family, names, method) of sigmoid states, those that pay most often first.

    Of three inputs and more, where records are not short, they begin as a bank of lags:
    on the catalyst temperature of a measured engine the error of groups left out was
    .060 when 250,000 samples trained, that of the closed form .112. Else they begin
    from subspace identification: on the Wiener-Hammerstein circuit and the Bouc-Wen
    damper they are the best of all kinds, on the Silverbox as good as products of three
    factors, on the cascaded tanks and the coupled drives worse.
    """
    if not preset.gates:
        return
    inputs = len(data.channels.inputs)
    most = min(MOST_COEFFICIENTS, data.samples / SAMPLES_PER_COEFFICIENT)
    banks = [()]
    if inputs > UNASKED_INPUTS and not preset.orders:
        if data.samples > SHORT_RECORDS:
            banks = [_lag_times(profile, float(data.sample_time))]
            banks += [()] if preset.rule == "best" else []
    for times in banks:
        orders = (len(times),) if times else _gated_orders(data, profile.output, preset)
        variables = inputs * (2 if times else 1)
        tried = BANK_GATES_TRIED if times else GATES_TRIED
        for gates, draw in tried[: preset.gates]:
            for n in orders:
                width = 1 + n + variables
                if (n + 1) * (width + gates) + gates * width <= most:
                    yield _gated(data, profile, times, n, gates, draw)


def _lag_times(profile: DataProfile, sample_time: float) -> tuple[float, ...]:
    """Time constants [s] of a bank of lags, fastest first: up to that of the slowest
    answer, each a few times the last one."""
    slow = profile.memory / SETTLING_TIMES
    spread = slow * BANK_FACTOR ** -np.arange(BANK_STATES)[::-1]
    return tuple(float(t) * sample_time for t in spread if t >= FASTEST_SAMPLES)


def _gated_orders(data: Dataset, output: str, preset: Preset) -> tuple[int, ...]:
    """Numbers of states: those wanted, or of long records one more than a linear model
    asks for and as many, of others as many and two.

    The best linear model of the Wiener-Hammerstein circuit has five states, the circuit
    six; with gates the error is .0074 and .0011.
    """
    if preset.orders:
        return preset.orders
    found = linear_order(thin_records(data, SEARCH_SAMPLES), output, MOST_LINEAR_STATES)
    found = FEW_GATED_STATES if found is None else found
    long = data.samples > LONG_RECORDS
    return (found + 1, found) if long else tuple(dict.fromkeys((found, 2)))


def _gated(
    data: Dataset,
    profile: DataProfile,
    times: tuple[float, ...],
    states: int,
    gates: int,
    draw: int,
) -> tuple[str, list[str], HiddenStates]:
    """One candidate; with time constants as a bank of lags."""
    long = data.samples > LONG_RECORDS
    method = HiddenStates(
        outputs=(profile.output,),
        states=states,
        degree=1,
        gates=gates,
        draw=draw,
        times=times,
        shrink=GATE_PULLS,
        ridge=GATE_RIDGE,
        window=_window(data),
        max_steps=STEPS_PER_PULL,
        first_steps=FIRST_STEPS,
        first_rows=FIRST_ROWS,
    )
    if times:
        slow = round(times[-1] / float(data.sample_time))
        room = max(profile.begin - BANK_LAG, method.window)
        window = min(max(slow, method.window), room)
        method = dataclasses.replace(
            method, window=window, stretch=STRETCH_TIMES * slow
        )
    if long:
        method = dataclasses.replace(method, first_rows=LONG_FIRST_ROWS)
    if long and times:
        method = dataclasses.replace(
            method,
            shrink=LONG_BANK_PULLS,
            max_steps=LONG_BANK_STEPS,
            first_steps=LONG_FIRST_STEPS,
        )
    elif long:
        method = dataclasses.replace(
            method,
            shrink=LONG_GATE_PULLS,
            ridge=LONG_GATE_RIDGE,
            max_steps=LONG_GATE_STEPS,
        )
    start = "bank of lags, " if times else ""
    lead = f"{states} states, {start}{gates} gates, draw {draw}"
    names = [f"{lead}, pull {pull:g}" for _, pull in method.stages]
    return GATED_FAMILY, names, method


def _window(data: Dataset) -> int:
    """Samples that starts are estimated from."""
    low, high = WINDOW_LIMITS
    return min(max(min(map(len, data)) // WINDOW_SHARE, low), high)


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

    divided: set[int] = set()
    for n, degree in _products(data, output, preset):
        if most_regions(n, degree):
            yield n, degree, 1
        regions = min(most_regions(n, 1), MOST_REGIONS)
        few = n <= REGION_STATES or n in preset.orders
        short = data.samples <= SHORT_RECORDS
        if short and few and regions > 1 and n not in divided:
            divided.add(n)
            yield n, 1, regions


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
    near = () if n is None else (n, n - 1 or 2) if short else (n,)
    own = ((states, degree) for degree in degrees for states in near)
    yield from dict.fromkeys([*own, *usual])
