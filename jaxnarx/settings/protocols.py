"""Methods of one's own: what `select` and `grow` ask of them.

Both are functions (or objects with `__call__`, which can hold settings) of plain NumPy
arrays, called on the host once for every modelled output: `columns` (terms, rows), a
row for each candidate term in the order of the pool, `output` (rows), `weight` (rows),
zero where a sample does not count, and `scheduling` (dims, rows), scaled to [0, 1].
Signals are scaled by their root mean square.
"""

from typing import Any, Protocol, runtime_checkable

from jaxnarx.extensions import Registry


@runtime_checkable
class Selector(Protocol):
    """Chooses terms: `select(pool, data, selector)`.

        def correlated(columns, output, weight):
            gain = abs(columns @ (weight * output)) / (columns**2 @ weight) ** 0.5
            return gain.argsort()[::-1][:5]

    Returns the rows of the terms in order of choice; coefficients, criteria and
    statuses follow as for any other choice.
    """

    def __call__(self, columns: Any, output: Any, weight: Any, /) -> Any: ...


@runtime_checkable
class Partitioner(Protocol):
    """Divides the operating space: `grow(terms, data, Given(partitioner, ...))`.

    Returns a validity function of `jaxnarx.models` of the scaled scheduling variables,
    such as `Gaussians(centre, log_width)`; local models are fitted to it as `Given`
    says.
    """

    def __call__(
        self, scheduling: Any, columns: Any, output: Any, weight: Any, /
    ) -> Any: ...


SELECTORS: Registry[Selector] = Registry("selector", {})
"""Selectors of other packages: `select(pool, data, "name")`, and `select = "name"` in
files."""

PARTITIONS: Registry[Partitioner] = Registry("partition", {})
"""Partitions of other packages, for `Given("name", scheduling=[...])`; `identify`
divides the best polynomials of closed form by each of them."""
