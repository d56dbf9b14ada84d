"""The front of structures that no other beats in everything."""

import numpy as np
from jaxtyping import Bool, Float


def pareto(
    points: Float[np.ndarray, "points objectives"],
) -> Bool[np.ndarray, " points"]:
    """Which points no other dominates, every objective to be made small.

    A point dominates another if it is nowhere larger and somewhere smaller; of equal
    points all stay. A point with a value that is not a number is never on the front;
    infinite values count as what they are. Without objectives all points are equal.
    """
    known = ~np.isnan(points).any(axis=1)
    front = np.zeros(len(points), bool)
    for i in np.flatnonzero(known):
        nowhere_larger = np.all(points <= points[i][None], axis=1)
        somewhere_smaller = np.any(points < points[i][None], axis=1)
        front[i] = not np.any(nowhere_larger & somewhere_smaller & known)
    return front
