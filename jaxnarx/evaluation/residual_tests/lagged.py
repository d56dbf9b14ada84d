"""Products of two series at lags, over many records at once and over gaps.

A series is an array (records, time) that is zero where it is not known: a product with
a missing sample, or with one beyond the border of a record, then counts nothing.
"""

import numpy as np
import scipy.fft
from jaxtyping import Float, Int


def lagged_products(
    earlier: Float[np.ndarray, "records time"],
    later: Float[np.ndarray, "records time"],
    lags: Int[np.ndarray, " lags"],
) -> Float[np.ndarray, " lags"]:
    """sum over records and t of `earlier[t - k] later[t]` for every lag k.

    Negative lags look ahead. It uses the fast Fourier transform, with zeros behind
    every record so that nothing wraps round: O(n log n) whatever the number of lags.
    """
    records, time = later.shape
    reach = int(np.abs(lags).max(initial=0))
    size = int(scipy.fft.next_fast_len(time + reach, real=True) or 1)
    total = np.zeros(size // 2 + 1, complex)
    for a, b in zip(earlier, later, strict=True):
        total += np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size)
    # The inverse is indexed by the lag; negative ones stand at the end.
    return np.fft.irfft(total, size)[lags]


def lagged_rows(
    series: Float[np.ndarray, "records time"],
    at: Int[np.ndarray, " rows"],
    lags: Int[np.ndarray, " lags"],
) -> Float[np.ndarray, "rows lags"]:
    """`series[t - k]` at the flat places `at` of t; zero beyond the record's border."""
    records, time = series.shape
    record, t = np.divmod(at, time)
    source = t[None, :] - lags[:, None]
    inside = (source >= 0) & (source < time)
    values = series[record[None, :], np.clip(source, 0, time - 1)]
    return np.where(inside, values, 0.0).T
