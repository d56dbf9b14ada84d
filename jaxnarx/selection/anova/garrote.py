"""A small convex quadratic program: the weights of the non-negative garrote.

Breiman, "Better subset regression using the nonnegative garrote", Technometrics 37
(1995); here with one weight per effect and an upper bound of one.
"""

import numpy as np
from jaxtyping import Float


def garrote(
    gram: Float[np.ndarray, "effects effects"],
    moment: Float[np.ndarray, " effects"],
    penalty: Float[np.ndarray, " effects"],
) -> Float[np.ndarray, " effects"]:
    """The c in [0, 1] that minimises c'Gc - 2 b'c + w'c, w >= 0.

    An active set method. A sweep of coordinate descent frees and binds coordinates;
    Newton steps over the free ones, each cut at the first bound it meets, then go to
    the minimum of their face. Each step goes down and there are finitely many faces. It
    ends when the optimality conditions hold: gradient zero inside, not negative at 0,
    not positive at 1. An effect without a contribution (G_kk = 0) gets 0.
    """
    target = moment - penalty / 2
    size = np.sqrt(np.diag(gram))
    live = np.flatnonzero(size > 0)
    c = np.zeros(len(gram))
    if not live.size:
        return c
    g, h, at = gram[np.ix_(live, live)], target[live], np.diag(gram)[live]
    rounding = 1e-12 * (np.abs(h) + size[live] * np.max(size))
    x = np.clip(h / at, 0.0, 1.0)
    for _ in range(1000):
        for k in range(len(x)):
            x[k] = min(max(x[k] + (h[k] - g[k] @ x) / at[k], 0.0), 1.0)
        x = _face(g, h, x)
        slope = g @ x - h
        wrong = np.where(x <= 0, -slope, np.where(x >= 1, slope, np.abs(slope)))
        if np.all(wrong <= rounding):
            break
    c[live] = x
    return c


def _face(
    g: Float[np.ndarray, "live live"],
    h: Float[np.ndarray, " live"],
    x: Float[np.ndarray, " live"],
) -> Float[np.ndarray, " live"]:
    """The minimum over the coordinates off their bounds; those that reach one stay."""
    x = x.copy()
    while (free := np.flatnonzero((x > 0) & (x < 1))).size:
        slope = (g @ x - h)[free]
        step = -np.linalg.lstsq(g[np.ix_(free, free)], slope, rcond=None)[0]
        bound = np.where(step > 0, 1.0, 0.0)
        reach = np.full(len(free), np.inf)
        np.divide(bound - x[free], step, out=reach, where=step != 0)
        first = int(np.argmin(reach))
        if reach[first] >= 1.0:
            x[free] = np.clip(x[free] + step, 0.0, 1.0)
            break
        x[free] = np.clip(x[free] + reach[first] * step, 0.0, 1.0)
        x[free[first]] = bound[first]
    return x
