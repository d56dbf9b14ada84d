"""Points spread evenly over a box: where to measure when every point costs time."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.checks import whole
from jaxnarx.errors import DataError, SpecError

Box = Float[Array, " inputs"] | Float[np.ndarray, " inputs"]

_MOST_POINTS = 2048


def latin_hypercube(
    key: PRNGKeyArray, count: int, low: Box, high: Box, *, improve: bool = False
) -> Float[Array, "points inputs"]:
    """`count` points in the box, one in each of `count` equal strata of every input.

    Within its stratum a point is uniform; the strata of different inputs are paired at
    random. `improve` swaps coordinates between points while this lowers the centred L2
    discrepancy (seconds for some hundred points). The points are drawn on the host:
    `key` cannot be traced.

    Reference: M. D. McKay, R. J. Beckman, W. J. Conover, Technometrics 21, 1979.
    """
    from scipy.stats import qmc

    low, high = box(low, high)
    optimization = "random-cd" if improve else None
    engine = qmc.LatinHypercube(len(low), optimization=optimization, **_seed(key))
    return _scale(engine.random(whole(count, "count")), low, high)


def sobol(
    count: int, low: Box, high: Box, *, key: PRNGKeyArray | None = None
) -> Float[Array, "points inputs"]:
    """The first `count` points of a Sobol sequence over the box.

    Every further point fills the largest gap, so a run that is stopped early is spread
    evenly too. Balance is exact at powers of two only: the next power of two is drawn
    and cut. With `key` the sequence is scrambled (Owen 1998); without, it is always the
    same and starts in the corner `low`. `key` cannot be traced.

    Reference: I. M. Sobol, USSR Comput. Math. Math. Phys. 7(4), 1967.
    """
    from scipy.stats import qmc

    low, high = box(low, high)
    count = whole(count, "count")
    seed = {} if key is None else _seed(key)
    engine = qmc.Sobol(len(low), scramble=key is not None, **seed)
    points = engine.random_base2((count - 1).bit_length())[:count]
    return _scale(points, low, high)


def uniform(
    key: PRNGKeyArray, count: int, low: Box, high: Box
) -> Float[Array, "points inputs"]:
    """`count` independent points, uniform over the box: what the others improve on."""
    low, high = box(low, high)
    shape = (whole(count, "count"), len(low))
    return _scale(jax.random.uniform(key, shape, float), low, high)


def discrepancy(
    points: Float[Array, "points inputs"] | Float[np.ndarray, "points inputs"],
    low: Box,
    high: Box,
) -> float:
    """Centred L2 discrepancy of points in a box: 0 is perfectly even, smaller better.

    The root of Hickernell's squared measure, of the points scaled to the unit cube;
    those outside count at its border. Dimensionless; compare only sets of about the
    same size and of the same number of inputs. Its cost grows with the square of the
    number of points: more than 2048 are thinned evenly to that number.

    Reference: F. J. Hickernell, Mathematics of Computation 67, 1998, equation (5.1).
    """
    from scipy.stats import qmc

    low, high = box(low, high)
    x = np.asarray(points, float)
    if not len(x) or not np.all(np.isfinite(x)):
        raise DataError(
            f"discrepancy needs finite points, got {len(x)} of which "
            f"{int(np.sum(~np.all(np.isfinite(x), axis=1)))} are not; leave those out"
        )
    kept = np.unique(np.linspace(0, len(x) - 1, _MOST_POINTS).astype(int))
    unit = np.clip((x[kept] - low) / (high - low), 0, 1)
    return float(np.sqrt(max(qmc.discrepancy(unit, method="CD"), 0.0)))


def box(
    low: Box, high: Box
) -> tuple[Float[np.ndarray, " inputs"], Float[np.ndarray, " inputs"]]:
    """Both borders as float arrays; finite, the same size, low < high."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    if low.shape != high.shape or low.ndim != 1 or not low.size:
        raise SpecError(
            f"low and high must have one number per input, got shapes {low.shape} and "
            f"{high.shape}",
            field="low",
        )
    if not (np.all(np.isfinite(low) & np.isfinite(high)) and np.all(low < high)):
        raise SpecError(
            f"low must be below high for every input, both finite, got {low} and "
            f"{high}",
            field="low",
        )
    return low, high


def _scale(unit, low, high) -> Float[Array, "points inputs"]:
    return jnp.asarray(low + (high - low) * np.asarray(unit), float)


def _seed(key: PRNGKeyArray) -> dict[str, Any]:
    """NumPy's generator seeded from the key's bits, as scipy's engines take it.

    They call it `rng` since release 1.15; the older name serves all.
    """
    bits = np.asarray(jax.random.key_data(key)).ravel()
    return {"seed": np.random.default_rng(bits)}
