"""A Euclidean norm in which many matrices contract at once.

The aim is an invertible L with the least `max_t ||L M_t L^-1||_2`: in the norm |L s|
every step s -> M_t s then shrinks by that rate at least. The problem is quasi-convex in
P = L'L (Boyd, El Ghaoui, Feron, Balakrishnan 1994, section 5.1). It is solved without a
semidefinite program, by quasi-Newton steps on a soft maximum that is hardened in
stages. With u_t and v_t the leading singular vectors of L M_t L^-1, a change L -> (1 +
E) L moves the logarithm of that norm by

    u_t' E u_t - v_t' E v_t ,

so that gradients cost one singular value decomposition. Any L gives a valid bound: what
the search misses makes the bound weaker, never wrong.
"""

import numpy as np
import scipy.linalg
import scipy.optimize
from jaxtyping import Float

NORM_FLOOR = 0.1
"""Norms below this are as good as zero: nilpotent matrices have no best L."""
CONDITION_PRICE = 1e-4
"""Price of log(|L| |L^-1|): the last 0.1 % of a rate is not worth a norm that lets runs
part by orders of magnitude before they meet."""
SHARPNESS_STAGES = (30.0, 300.0, 3000.0)
"""Sharpness of the soft maximum, in turn."""
STEPS_PER_STAGE = 60
"""Quasi-Newton steps at each of them."""
MATRIX_ROUNDS = 5
FIRST_MATRICES = 48
ADDED_MATRICES = 24
"""Matrices to begin with, and added in every round."""


def norms(
    l: Float[np.ndarray, "n n"],  # noqa: E741 - the paper's letter
    m: Float[np.ndarray, "points n n"],
) -> Float[np.ndarray, " points"]:
    """||L M L^-1||_2 of every matrix, infinite where one is not finite."""
    g = l @ m @ np.linalg.inv(l)
    fine = np.isfinite(g).all(axis=(1, 2))
    out = np.full(len(m), np.inf)
    gram = np.swapaxes(g[fine], 1, 2) @ g[fine]
    if fine.any():
        # Of the product, not the matrix: several times faster, and largest values keep
        # their digits.
        out[fine] = np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[:, -1], 0.0))
    return out


def _unpack(x: Float[np.ndarray, " entries"], n: int) -> Float[np.ndarray, "n n"]:
    l = np.zeros((n, n))  # noqa: E741
    l[np.triu_indices(n)] = x
    at = np.arange(n)
    l[at, at] = np.exp(np.clip(l[at, at], -40.0, 40.0))
    return l


def _pack(l: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " entries"]:  # noqa: E741
    l = l.copy()  # noqa: E741
    at = np.arange(len(l))
    l[at, at] = np.log(l[at, at])
    return l[np.triu_indices(len(l))]


def _leading_vectors(g: Float[np.ndarray, "points n n"]):
    """Leading singular vectors and value of every matrix, by its Gram matrix."""
    squares, vectors = np.linalg.eigh(np.swapaxes(g, 1, 2) @ g)
    s, v = np.sqrt(np.maximum(squares[:, -1], 0.0)), vectors[:, :, -1]
    u = (g @ v[:, :, None])[:, :, 0] / np.maximum(s, 1e-150)[:, None]
    return u, s, v


def _objective(x, m, sharpness):
    """Soft maximum of log ||L M L^-1||, and its gradient by the entries of L."""
    n = m.shape[1]
    l = _unpack(x, n)  # noqa: E741
    k = np.linalg.inv(l)
    g = l @ m @ k
    if not np.isfinite(g).all():  # a trial step of the line search went too far
        return 1e6, np.zeros_like(x)
    u, s, v = _leading_vectors(g)
    value = np.log(np.maximum(s, NORM_FLOOR))
    top = value.max()
    share = np.exp(sharpness * (value - top))
    total = share.sum()
    w = np.where(s > NORM_FLOOR, share / total, 0.0)[:, None]
    size, inverse = np.sum(l**2), np.sum(k**2)
    slope = ((w * u).T @ u - (w * v).T @ v) @ k.T
    slope += CONDITION_PRICE * (l / size - k.T @ k @ k.T / inverse)
    at = np.arange(n)
    slope[at, at] *= l[at, at]
    price = 0.5 * CONDITION_PRICE * np.log(size * inverse)
    value = top + np.log(total) / sharpness + price
    return value, slope[np.triu_indices(n)]


def _starts(m: Float[np.ndarray, "points n n"]) -> list[Float[np.ndarray, "n n"]]:
    """Weights that fade with the lag, and the Lyapunov norm of the mean matrix."""
    n = m.shape[1]
    fading = [np.diag(rate ** np.arange(n)) for rate in (1.0, 0.9, 0.6)]
    mean = m.mean(axis=0)
    radius = np.abs(np.linalg.eigvals(mean)).max()
    scaled = mean / max(1.03 * radius, NORM_FLOOR)
    p = scipy.linalg.solve_discrete_lyapunov(scaled.T, np.eye(n))
    try:
        return [*fading, np.linalg.cholesky(p).T]
    except np.linalg.LinAlgError:
        return fading


def _descend(x, m, stages):
    for sharpness in stages:
        x = scipy.optimize.minimize(
            _objective,
            x,
            args=(m, sharpness),
            jac=True,
            method="BFGS",
            options={"maxiter": STEPS_PER_STAGE},
        ).x
    return x


def contracting_norm(
    m: Float[np.ndarray, "points n n"],
) -> Float[np.ndarray, "n n"]:
    """L, upper triangular, that makes the largest ||L M L^-1||_2 small.

    Works on a few of the matrices and adds those that violate the rate found most,
    until what is left over costs less than 2 % of the distance of the rate from one.
    Matrices that are not finite are passed over: no norm helps them.
    """
    m = m[np.isfinite(m).all(axis=(1, 2))]
    n = m.shape[1]
    if not m.any():
        return np.eye(n)
    best = min(_starts(m), key=lambda l: norms(l, m).max())  # noqa: E741
    found = norms(best, m)
    x, least, stages = _pack(best), found.max(), SHARPNESS_STAGES
    chosen = np.unique(np.linspace(0, len(m) - 1, FIRST_MATRICES).astype(int))
    for _ in range(MATRIX_ROUNDS):
        chosen = np.union1d(chosen, np.argsort(found)[-ADDED_MATRICES:])
        x = _descend(x, m[chosen], stages)
        found = norms(_unpack(x, n), m)
        if found.max() < least:
            best, least = _unpack(x, n), found.max()
        known = found[chosen].max()
        if found.max() <= known + 0.02 * abs(1 - known) + 1e-9:
            break
        stages = SHARPNESS_STAGES[1:]
    return best
