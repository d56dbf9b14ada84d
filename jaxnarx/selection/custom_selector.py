"""Choice by a function of the user's own, see `jaxnarx.settings.Selector`."""

import numpy as np
from jaxtyping import Bool

from jaxnarx.errors import DataError, SpecError
from jaxnarx.regressors import Pool, Rows, evaluate
from jaxnarx.settings import Selector

MOST_BYTES = 2**31
"""Bytes that the columns of all candidate terms may take where all are formed."""


def require_room(terms: int, rows: Rows, field: str, advice: str) -> None:
    """`SpecError` where the columns of so many candidate terms would be too large."""
    size = terms * rows.v.shape[1] * rows.v.dtype.itemsize
    if size > MOST_BYTES:
        raise SpecError(
            f"{terms} candidate terms on {rows.v.shape[1]} rows are "
            f"{size / 2**30:.1f} GiB; {advice}",
            field=field,
        )


def own_choice(
    pool: Pool, rows: Rows, method: Selector, usable: Bool[np.ndarray, " terms"]
) -> list[list[int]]:
    """The terms of every output in order of choice, among the usable ones."""
    places = np.flatnonzero(usable)
    require_room(
        len(places), rows, "method", "narrow the pool first, with ForwardOLS or Anova"
    )
    columns = np.asarray(evaluate(pool.factor[places], rows.v))[:, : rows.count]
    names = [pool.channels.output_names[o] for o in pool.outputs]
    y, weight = (np.asarray(a)[:, : rows.count] for a in (rows.y, rows.weight))
    lanes = zip(names, y, weight, strict=True)
    return [
        places[_check_choice(method(columns, y, w), len(places), n)].tolist()
        for n, y, w in lanes
    ]


def _check_choice(found, terms: int, name: str) -> np.ndarray:
    index = np.asarray(found)
    if not index.size:
        raise DataError(f"the selector chose no term of {name}", channel=name)
    whole = index.ndim == 1 and np.issubdtype(index.dtype, np.integer)
    if not whole or index.min() < 0 or index.max() >= terms:
        raise SpecError(
            f"a selector returns rows of its {terms} columns, such as [0, 3], got "
            f"{found!r:.60}",
            field="method",
        )
    return index[np.sort(np.unique(index, return_index=True)[1])]
