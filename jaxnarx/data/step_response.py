"""Time constants seen in step responses that are estimated from the data."""

import numpy as np

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.response import Responses, responses
from jaxnarx.errors import DataError, SpecError, suggest

_REACH = 2000
"""Largest lag looked at [samples]."""

_SILENCE = 10
"""Least silence [samples] that ends a response."""

_SHARE = 1 - np.exp(-1)
"""What a first-order lag has covered of a step after its time constant."""


def step_times(data: Dataset, output: str) -> dict[str, float]:
    """Seconds that `output` takes for 63 % of its answer to a step of each input.

    The step response is the sum over the whitened correlations (`Responses`, Box and
    Jenkins 1970, section 11.2) of one input with the output that stand clear of chance;
    the time counts from the end of the dead time. For a first-order lag this is its
    time constant, less a tenth for the tail that is lost in chance. Responses that
    change sign are counted by magnitude. Lags up to 2000 samples and a third of the
    longest record are seen. Inputs without a clear response are left out.
    """
    known = data.channels.output_names
    if output not in known:
        raise SpecError(
            f"unknown output {output!r}. {suggest(output, known)}", field="output"
        )
    if not data.samples:
        raise DataError("step times need at least one record with samples")
    found = responses(data, reach=_REACH)
    o = known.index(output)
    times = {
        name: float(_rise(found, i, o) * data.sample_time)
        for i, name in enumerate(data.channels.input_names)
        if found.dead_time(i, o) is not None
    }
    return times


def _rise(found: Responses, i: int, o: int) -> float:
    """Samples from the dead time until the cumulated response has covered its share.

    Interpolated between samples; at least a half.
    """
    dead = found.dead_time(i, o)
    assert dead is not None
    size = np.abs(found.forward(i, o))[dead:]
    clear = np.flatnonzero(size > max(found.bound, 0.05 * float(size.max())))
    # what comes after a silence longer than all before it is chance
    apart = np.flatnonzero(clear[1:] > 2 * clear[:-1] + _SILENCE)
    clear = clear[: apart[0] + 1] if apart.size else clear
    total = np.cumsum(np.where(np.isin(np.arange(size.size), clear), size, 0.0))
    share = total / total[-1]
    after = int(np.argmax(share >= _SHARE))
    before = share[after - 1] if after else 0.0
    part = (_SHARE - before) / (share[after] - before)
    return max(after + part, 0.5)
