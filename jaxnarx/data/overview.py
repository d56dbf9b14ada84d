"""A dataset in words: its channels with their ranges, and its records."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxnarx.data.channels import Channels
from jaxnarx.data.record import Record
from jaxnarx.formatting import align_columns, some


def overview(
    records: Sequence[Record], channels: Channels, time: float, notes: Sequence[str]
) -> str:
    """Size, then a line for every channel and every record.

    Ranges, mean and standard deviation are those of valid samples; a channel without
    any has dashes.
    """
    samples = sum(map(len, records))
    count = f"{len(records)} record" + "s" * (len(records) != 1)
    lines = [
        f"Dataset: {count}, {samples} samples at {time:g} s "
        f"({_duration(samples * time)})",
        *align_columns(_ranges(records, channels), [True, True, True, *(False,) * 5]),
        *some([f"  {_sizes(one, time)}" for one in records]),
        *(f"note: {note}" for note in notes),
    ]
    return "\n".join(lines)


def _ranges(records: Sequence[Record], channels: Channels) -> list[list[str]]:
    heads = ["", "channel", "unit", "least", "mean", "largest", "deviation", "missing"]
    rows = [heads]
    for j, channel in enumerate(channels.measured.all):
        valid = [r.signal(j)[r.valid[:, j]] for r in records]
        known = np.concatenate(valid) if valid else np.zeros(0)
        missing = sum(map(len, records)) - len(known)
        kind = "input" if j < len(channels.inputs) else "output"
        gaps = str(missing) if missing else ""
        rows.append([kind, channel.name, channel.unit, *_figures(known), gaps])
    return rows


def _figures(known: Float[np.ndarray, " samples"]) -> list[str]:
    """Least, mean, largest, standard deviation."""
    if not len(known):
        return ["-"] * 4
    # In shares of the largest: squares and sums of huge values stay finite.
    size = float(np.max(np.abs(known))) or 1.0
    share = known.astype(float) / size
    told = share.min(), share.mean(), share.max(), share.std()
    return [f"{size * value:.4g}" for value in told]


def _sizes(record: Record, time: float) -> str:
    gaps = int((~record.valid).any(axis=1).sum())
    group = f", group {record.group}" if record.group else ""
    missing = f", {gaps} with something missing" if gaps else ""
    return (
        f"{record.name}: {len(record)} samples, {_duration(len(record) * time)}"
        f"{group}{missing}"
    )


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.4g} s"
    return f"{seconds / 60:.4g} min" if seconds < 7200 else f"{seconds / 3600:.4g} h"
