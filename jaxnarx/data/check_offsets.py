"""Channels so far from zero that sums of their products lose digits."""

from collections.abc import Iterator

import numpy as np

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.findings import Finding
from jaxnarx.data.scaling import unit_of

HUGE = 1e3
"""Mean in standard deviations from which a channel is named: cubic terms then cancel to
1e-9 of themselves, quadratic ones to 1e-6."""


def offsets(data: Dataset) -> Iterator[Finding]:
    """Channels whose mean is huge beside what they move."""
    inputs = len(data.channels.inputs)
    for j, name in enumerate(data.channels.names):
        columns = [r.u[:, j] if j < inputs else r.y[:, j - inputs] for r in data]
        x = np.concatenate(
            [c[r.valid[:, j]] for c, r in zip(columns, data, strict=True)]
        )
        if not x.size or x.min() == x.max():
            continue
        unit = unit_of(x)
        mean, spread = float((x / unit).mean() * unit), float((x / unit).std() * unit)
        if abs(mean) <= HUGE * spread:
            continue
        ratio = abs(mean) / spread if spread > 0 else np.inf
        yield Finding(
            "warning",
            "offset",
            f"{name} moves by {spread:.3g} (standard deviation) around {mean:.6g}, "
            f"{ratio:.1e} times as much. Its products are taken into a model after "
            "their parts, and their sum loses digits: take the offset off, or measure "
            "the difference.",
            channel=name,
        )
