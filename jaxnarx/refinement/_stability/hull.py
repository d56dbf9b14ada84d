"""Everything A can be while the outputs move within their bounds, by intervals.

Where no scheduling variable is an output, y_t = G_t . h(history) with G_t known from
the inputs. Then A_t[., e] = G_t . dh/dx_e, and dh/dx_e are monomials whose range over
the box [lower, upper] interval arithmetic gives (Moore 1966). The derivative between
any two histories of the box is a mean of such A along their connection, so it lies in
the interval too.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxnarx.arrays import program
from jaxnarx.models import (
    Network,
    collapse,
    collapses,
    depth,
    fed_back_variables,
    monomials,
)
from jaxnarx.refinement._stability.points import Points, map_chunks

Interval = tuple[np.ndarray, np.ndarray]


def power(low: float, high: float, exponent: int) -> tuple[float, float]:
    """Range of x**exponent for x in [low, high]; exponent 0 gives [1, 1]."""
    ends = sorted((low**exponent, high**exponent))
    if exponent and exponent % 2 == 0 and low < 0 < high:
        return 0.0, ends[1]
    return ends[0], ends[1]


def product(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    """Range of the product of two independent factors."""
    ends = [x * y for x in a for y in b]
    return min(ends), max(ends)


def _slopes(
    table: np.ndarray, box: list[tuple[float, float]]
) -> tuple[Float[np.ndarray, "monomials e"], Float[np.ndarray, "monomials e"]]:
    """Lower and upper end of d h_a / d x_e for every monomial and fed-back variable."""
    low = np.zeros((len(table), len(box)))
    high = np.zeros_like(low)
    for a, row in enumerate(table.tolist()):
        for e in set(row) - {0}:
            found = (float(row.count(e)), float(row.count(e)))
            for other in set(row) - {0}:
                count = row.count(other) - (other == e)
                lower, upper = box[other - 1]
                found = product(found, power(lower, upper, count))
            low[a, e - 1], high[a, e - 1] = found
    return low, high


@program
def _collapse(network: Network, v, x, history):
    del history
    return jnp.moveaxis(collapse(network, v, x), -1, 0)


def hull(network: Network, points: Points) -> Interval | None:
    """Centre and radius of A over the feedback box, (points, outputs, outputs, depth).

    None where the network is scheduled on its own outputs (or has too many feedback
    monomials to collapse, or groups with feedback of their own): there is no such bound
    then. A radius of zero everywhere
    means that A depends on the inputs alone.
    """
    if network.parallel or not collapses(network):
        return None
    own = fed_back_variables(network.variables, network.signals)
    lower, upper = (np.asarray(a, np.float64) for a in (network.lower, network.upper))
    box = [(float(lower[o]), float(upper[o])) for _, o, _ in own]
    low, high = _slopes(monomials(network), box)
    g = map_chunks(lambda *p: _collapse(network, *p), points, axis=0)
    shape = (len(points), g.shape[1], g.shape[1], depth(network))
    centre, radius = np.zeros(shape), np.zeros(shape)
    for e, (_, output, lag) in enumerate(own):
        centre[:, :, output, lag] += g @ (0.5 * (low + high)[:, e])
        radius[:, :, output, lag] += np.abs(g) @ (0.5 * (high - low)[:, e])
    return centre, radius
