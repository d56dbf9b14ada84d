"""Whether inputs excite a model, and whether they follow past outputs."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.pieces import pieces
from jaxnarx.data.scaling import scaling_unit

_PE_TOLERANCE = 1e-9


def excitation_order(data: Dataset, i: int, *, order: int) -> int:
    """Order, up to `order`, of which input `i` is persistently exciting.

    The rank of the covariance of (u(t), ..., u(t - order + 1)) without its mean, where
    eigenvalues below 1e-9 of the largest count as zero: a constant has order 0, a sine
    2, a sum of m sines 2 m (Söderström and Stoica 1989, section 5.4). Windows do not
    cross records.
    """
    unit = scaling_unit(*(record.u[:, i] for record in data))
    level = float((data.records[0].u[:, i] / unit).mean())
    gram, total, count = np.zeros((order, order)), np.zeros(order), 0
    for record in data:
        if len(record) < order:
            continue
        x = record.u[:, i].astype(np.float64) / unit - level
        own, sums = _lagged_sums(x, order)
        gram += own
        total += sums
        count += len(x) - order + 1
    power = np.trace(gram)
    # every lag loses its own mean: one common mean would leave a constant of rank one
    gram -= np.outer(total, total) / max(count, 1)
    values = np.linalg.eigvalsh(gram)
    if values[-1] <= 1e-20 * power + 1e-24 * level**2 * count:
        return 0
    return int(np.sum(values > _PE_TOLERANCE * values[-1]))


def _lagged_sums(
    x: Float[np.ndarray, " time"], order: int
) -> tuple[Float[np.ndarray, "order order"], Float[np.ndarray, " order"]]:
    """Sums of x(t - a) x(t - b) and of x(t - a), over all t with full history.

    Along a diagonal the sums differ by the products at both ends only, so that one
    inner product for each diagonal is enough.
    """
    n = len(x)
    gram, total = np.zeros((order, order)), np.zeros(order)
    for k in range(order):
        # windows end at t = order - 1, ..., n - 1; the first pair is x(t), x(t - k)
        # not by BLAS, whose threads cost more than so short a product
        first = np.einsum("t,t", x[order - 1 :], x[order - 1 - k : n - k])
        steps = np.arange(order - 1 - k)
        came = x[order - 2 - steps] * x[order - 2 - steps - k]
        left = x[n - 1 - steps] * x[n - 1 - steps - k]
        line = first + np.concatenate([[0.0], np.cumsum(came - left)])
        where = np.arange(order - k)
        gram[where, where + k] = gram[where + k, where] = line
        total[k] = x[order - 1 - k : n - k].sum()
    return gram, total


_AR_ORDER = 20


@dataclasses.dataclass(frozen=True, eq=False)
class Correlations:
    """Correlation of every whitened input with every output, by lag.

    Both are filtered by the inverse of the input's autoregressive model. `ahead` is
    that of the input with the output after 0, 1, ... samples, proportional to the
    impulse response (Box and Jenkins 1970, section 11.2); `past` with the output 1, 2,
    ... samples before, which vanishes unless outputs act back on the input. `bound` is
    the level, four standard deviations, that chance exceeds in one of 16,000 cases.
    Constant channels have zeros.
    """

    ahead: Float[np.ndarray, "inputs outputs lags"]
    past: Float[np.ndarray, "inputs outputs leads"]
    bound: float


def correlations(data: Dataset, *, past: int = 20, ahead: int = 100) -> Correlations:
    """Prewhitened correlations pooled over pieces, in the frequency domain.

    Each piece is freed of its mean and padded, so that nothing wraps around.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    parts = pieces(data)
    longest = max(len(p) for p in parts)
    past, ahead = (max(1, min(k, longest // 3)) for k in (past, ahead))
    size = int(next_fast_len(longest + ahead + _AR_ORDER, real=True) or 0)
    n, outputs = len(parts[0].u), len(parts[0].y)
    power = np.zeros((n + outputs, size // 2 + 1))
    cross = np.zeros((n, outputs, size // 2 + 1), complex)
    for part in parts:
        x = np.concatenate([part.u, part.y])
        spectrum = np.asarray(rfft(x - x.mean(axis=1, keepdims=True), size))
        power += np.abs(spectrum) ** 2
        cross += spectrum[:n, None].conj() * spectrum[None, n:]
    whiten = np.ones((n, size // 2 + 1))
    for i in range(n):
        whiten[i] = _whitening_gain(np.asarray(irfft(power[i], size)), size)
    values = np.asarray(irfft(cross * whiten[:, None], size))
    variance_u = np.asarray(irfft(power[:n] * whiten, size))[:, 0]
    variance_y = np.asarray(irfft(power[None, n:] * whiten[:, None], size))[..., 0]
    scale = np.sqrt(np.maximum(variance_u[:, None] * variance_y, 0.0))
    alive = scale > 1e-12 * max(float(scale.max(initial=0.0)), 1e-300)
    values = np.where(alive[..., None], values, 0.0)
    values /= np.where(alive, scale, 1.0)[..., None]
    return Correlations(
        values[..., : ahead + 1],
        values[..., -1 : -past - 1 : -1],
        4 / np.sqrt(sum(len(p) for p in parts)),
    )


def _whitening_gain(auto: Float[np.ndarray, " lags"], size: int):
    """Squared gain of the filter 1 - sum a_k q^-k that whitens this autocovariance."""
    order = min(_AR_ORDER, size // 4)
    if auto[0] <= 0:
        return np.ones(size // 2 + 1)
    index = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
    toeplitz = auto[index] + 1e-9 * auto[0] * np.eye(order)
    a = np.linalg.solve(toeplitz, auto[1 : order + 1])
    return np.abs(np.fft.rfft(np.concatenate([[1.0], -a]), size)) ** 2
