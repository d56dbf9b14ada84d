"""Of which order inputs are persistently exciting."""

import numpy as np
from jaxtyping import Float

from jaxnarx.data.dataset import Dataset
from jaxnarx.data.scaling import unit_of

_PE_TOLERANCE = 1e-9


def excitation_order(data: Dataset, i: int, *, order: int) -> int:
    """Order, up to `order`, of which input `i` is persistently exciting.

    The rank of the covariance of (u(t), ..., u(t - order + 1)) without its mean, where
    eigenvalues below 1e-9 of the largest count as zero: a constant has order 0, a sine
    2, a sum of m sines 2 m (Söderström and Stoica 1989, section 5.4). Windows do not
    cross records.
    """
    unit = unit_of(*(record.u[:, i] for record in data))
    level = float((data.records[0].u[:, i] / unit).mean())
    gram, total, count = np.zeros((order, order)), np.zeros(order), 0
    for record in data:
        if len(record) < order:
            continue
        x = record.u[:, i].astype(np.float64) / unit - level
        own, sums = _lagged(x, order)
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


def _lagged(
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
