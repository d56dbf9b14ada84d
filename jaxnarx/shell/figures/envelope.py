"""Long lines in few points."""

import numpy as np
from jaxtyping import Float

LINE_POINTS = 1500


def envelope(
    time: Float[np.ndarray, " time"],
    value: Float[np.ndarray, " time"],
    points: int = LINE_POINTS,
) -> tuple[Float[np.ndarray, " points"], Float[np.ndarray, " points"]]:
    """At most `points` samples that draw the same line: least and largest of each bin.

    Both keep their own time and order. A short record comes back as it is; missing
    values (NaN) stay gaps where a whole bin is missing.
    """
    bins = max(points // 2, 1)
    if len(value) <= 2 * bins:
        return time, value
    borders = np.linspace(0, len(value), bins + 1).astype(int)
    low = np.where(np.isnan(value), np.inf, value)
    high = np.where(np.isnan(value), -np.inf, value)
    kept = np.array(
        [
            sorted((a + int(np.argmin(low[a:b])), a + int(np.argmax(high[a:b]))))
            for a, b in zip(borders[:-1], borders[1:], strict=True)
        ]
    ).ravel()
    return time[kept], value[kept]
