"""Time constants seen in step responses that are estimated from the data."""

from collections.abc import Collection

import numpy as np

from jaxnarx.checks import known_name
from jaxnarx.data.dataset import Dataset
from jaxnarx.data.dynamics import dynamics
from jaxnarx.errors import DataError


def step_times(data: Dataset, output: str) -> dict[str, float]:
    """Seconds that `output` takes for 63 % of its answer to a step of each input.

    Of the systems of low order that best explain the output in free run (`dynamics`),
    from the end of the dead time: for a first-order lag its time constant. Responses
    that change sign are counted by magnitude. Inputs without a clear response are left
    out.
    """
    known = data.channels.output_names
    known_name(output, known, "output")
    if not data.samples:
        raise DataError("step times need at least one record with samples")
    found, o = dynamics(data), known.index(output)
    answers = {name: found[i, o] for i, name in enumerate(data.channels.input_names)}
    return {
        name: float(a.rise * data.sample_time)
        for name, a in answers.items()
        if a is not None and a.clear
    }


def bank_times(
    rise_times: Collection[float], count: int, *, sample_time: float
) -> list[float]:
    """Time constants [s] of a bank of lags for answers of `rise_times` [s].

    A geometric series from half the shortest, but not less than the sample time, to
    twice the longest; one alone is the mean of both.
    """
    shortest = max(min(rise_times), sample_time)
    longest = max(*rise_times, shortest)
    if count == 1:
        return [float(np.sqrt(shortest * longest))]
    first = max(shortest / 2, sample_time)
    return np.geomspace(first, 2 * longest, count).tolist()
