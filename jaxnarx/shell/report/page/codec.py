"""Series of numbers as text: rounded, differences taken, deflated.

A series is rounded to so many levels between its least and its largest value. What is
stored of n samples are the differences of the levels modulo 65,536, all low bytes
before all high ones; 65,535 stands for what is no number. Series of one record are
deflated together and written in base 64; `page/codec.js` reads them.
"""

import base64
import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float

FINE_LEVELS, MIDDLE_LEVELS, COARSE_LEVELS = 65_000, 4_000, 1_000
"""Levels of a series."""
MISSING_CODE = 65_535
MAX_MAGNITUDE = 8e307
"""Values beyond are taken as this, so that their distances are numbers."""


def encode(
    value: Float[np.ndarray, " samples"], levels: int
) -> tuple[bytes, float, float]:
    """Bytes, least value, and distance of the levels (0 of a constant series)."""
    good = np.isfinite(value)
    value = np.clip(np.where(good, value, 0.0), -MAX_MAGNITUDE, MAX_MAGNITUDE)
    low = float(value[good].min()) if good.any() else 0.0
    high = float(value[good].max()) if good.any() else 0.0
    step = (high - low) / levels
    fine = step > np.finfo(float).tiny
    share = value / step - low / step if fine else np.zeros(len(value))
    code = np.where(good, np.rint(share), MISSING_CODE).astype(np.int64)
    change = np.diff(code, prepend=0).astype(np.uint16)
    planes = (change & 255).astype(np.uint8), (change >> 8).astype(np.uint8)
    return b"".join(p.tobytes() for p in planes), low, step if fine else 0.0


def pack(
    series: Iterable[tuple[str, int, Float[np.ndarray, " samples"]]], most: int
) -> dict[str, Any]:
    """Named series of one length, each with its levels (no more than `most`), as JSON
    values: `text` and `series`."""
    parts, header = [], []
    for name, levels, value in series:
        part, low, step = encode(np.asarray(value, float), min(levels, most))
        parts.append(part)
        header.append([name, low, step])
    data = zlib.compress(b"".join(parts), 6)
    return {"series": header, "text": base64.b64encode(data).decode("ascii")}
