"""What the data alone tell about delays: prewhitened cross-correlation, excitation."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxnarx.data.check_samples import signals
from jaxnarx.data.dataset import Dataset

_AR_ORDER = 20
_PE_TOLERANCE = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Responses:
    """Correlation of every whitened input with every output, at lags -reach to reach.

    `correlation[i, o, reach + k]` is that of input i at t with output o at t + k, both
    filtered by the inverse of input i's autoregressive model; for k >= 0 it is
    proportional to the impulse response (Box and Jenkins 1970, section 11.2), for k < 0
    it vanishes unless outputs act back on the input. `bound` is the level, four
    standard deviations, that chance exceeds in one of 16,000 cases. Constant channels
    have zeros.
    """

    correlation: Float[np.ndarray, "inputs outputs lags"]
    bound: float
    reach: int

    def forward(self, i: int, o: int) -> Float[np.ndarray, " lags"]:
        """Lags 0 to reach."""
        return self.correlation[i, o, self.reach :]

    def backward(self, i: int, o: int) -> Float[np.ndarray, " lags"]:
        """Lags -1 to -reach, in this order."""
        return self.correlation[i, o, : self.reach][::-1]

    def dead_time(self, i: int, o: int) -> int | None:
        """First lag with a clear response, in samples; None where there is none.

        Clear is above `bound` and above a fifth of the largest.
        """
        size = np.abs(self.forward(i, o))
        clear = size > max(self.bound, 0.2 * float(size.max()))
        return int(np.argmax(clear)) if clear.any() else None

    def settling(self, i: int, o: int) -> int | None:
        """Lag by which 19 of 20 parts of the significant response are over, or None."""
        size = np.abs(self.forward(i, o))
        size = np.where(size > max(self.bound, 0.05 * float(size.max())), size, 0)
        if not size.any():
            return None
        return int(np.searchsorted(np.cumsum(size), 0.95 * size.sum()))


def responses(data: Dataset, *, reach: int = 100) -> Responses:
    """Prewhitened correlations pooled over records, in the frequency domain.

    Each record is freed of its mean and padded, so that nothing wraps around. `reach`,
    in samples, is cut to a third of the longest record.
    """
    longest = max(len(r) for r in data)
    reach = max(1, min(reach, longest // 3))
    n = len(data.channels.inputs)
    size = _fast_length(longest + reach + _AR_ORDER)
    power = np.zeros((len(data.channels.names), size // 2 + 1))
    cross = np.zeros((n, len(data.channels.outputs), size // 2 + 1), complex)
    for record in data:
        x = signals(record).astype(np.float64)
        spectrum = np.fft.rfft(x - x.mean(axis=0), size, axis=0).T
        power += np.abs(spectrum) ** 2
        cross += spectrum[:n, None].conj() * spectrum[None, n:]
    filters = np.ones((n, size // 2 + 1))
    for i in range(n):
        filters[i] = _whitening(np.fft.irfft(power[i], size), size)
    return Responses(
        _correlate(power, cross, filters, size, reach),
        4 / np.sqrt(data.samples),
        reach,
    )


def _correlate(power, cross, filters, size, reach):
    n = len(filters)
    values = np.fft.irfft(cross * filters[:, None], size)
    variance_u = np.fft.irfft(power[:n] * filters, size)[:, 0]
    variance_y = np.fft.irfft(power[None, n:] * filters[:, None], size)[..., 0]
    scale = np.sqrt(variance_u[:, None] * variance_y)
    lags = np.concatenate([values[..., size - reach :], values[..., : reach + 1]], -1)
    alive = scale > 1e-12 * max(float(scale.max(initial=0.0)), 1e-300)
    return np.where(alive[..., None], lags / np.where(alive, scale, 1)[..., None], 0.0)


def _whitening(auto: Float[np.ndarray, " lags"], size: int):
    """Squared gain of the filter 1 - sum a_k q^-k that whitens this autocovariance."""
    order = min(_AR_ORDER, size // 4)
    if auto[0] <= 0:
        return np.ones(size // 2 + 1)
    index = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
    toeplitz = auto[index] + 1e-9 * auto[0] * np.eye(order)
    a = np.linalg.solve(toeplitz, auto[1 : order + 1])
    return np.abs(np.fft.rfft(np.concatenate([[1.0], -a]), size)) ** 2


def _fast_length(n: int) -> int:
    """The least 2^a or 3 * 2^a that is not below `n`."""
    power = 1 << (n - 1).bit_length()
    return 3 * power // 4 if 3 * power // 4 >= n else power


def excitation_order(data: Dataset, i: int, *, order: int) -> int:
    """Order, up to `order`, of which input `i` is persistently exciting.

    The rank of the covariance of (u(t), ..., u(t - order + 1)) without its mean, where
    eigenvalues below 1e-9 of the largest count as zero: a constant has order 0, a sine
    2, a sum of m sines 2 m (Söderström and Stoica 1989, section 5.4). Windows do not
    cross records.
    """
    level = float(data.records[0].u[:, i].mean())
    gram, total, count = np.zeros((order, order)), np.zeros(order), 0
    for record in data:
        if len(record) < order:
            continue
        x = record.u[:, i].astype(np.float64) - level
        windows = np.lib.stride_tricks.sliding_window_view(x, order)
        gram += windows.T @ windows
        total += windows.sum(axis=0)
        count += len(windows)
    power = np.trace(gram)
    # every lag loses its own mean: one common mean would leave a constant of rank one
    gram -= np.outer(total, total) / max(count, 1)
    values = np.linalg.eigvalsh(gram)
    if values[-1] <= 1e-20 * power + 1e-24 * level**2 * count:
        return 0
    return int(np.sum(values > _PE_TOLERANCE * values[-1]))
