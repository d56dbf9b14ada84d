"""Pools as the settings describe them, and one that serves several settings."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool

from jaxnarx.data import Channels
from jaxnarx.errors import SpecError
from jaxnarx.regressors import Pool, polynomial_pool
from jaxnarx.settings import Polynomial


def make_pool(method: Polynomial | Pool, channels: Channels) -> Pool:
    """The pool that the settings describe; `SpecError` where a name is wrong."""
    if isinstance(method, Pool):
        if method.channels != channels:
            raise SpecError(
                "the pool belongs to other channels than the data; make it with "
                "polynomial_pool(data.channels, ...)",
                field="pool",
            )
        return method
    return polynomial_pool(
        channels,
        outputs=method.outputs or None,
        input_lags=method.input_lags,
        output_lags=method.output_lags,
        degree=method.degree,
        filters=method.filters,
        filter_lags=method.filter_lags,
    )


def joint_pool(methods: Sequence[Polynomial | Pool], channels: Channels) -> Pool:
    """One pool with the terms of all, so that one program serves them all."""
    distinct: list[Polynomial] = []
    for method in methods:
        if isinstance(method, Pool):
            return make_pool(method, channels)
        if method not in distinct:
            distinct.append(method)
    if len(distinct) == 1:
        return make_pool(distinct[0], channels)
    pools = [make_pool(m, channels) for m in distinct]
    if len({pool.outputs for pool in pools}) > 1:
        raise SpecError("pool.outputs must be the same in all cases", field="outputs")
    names = channels.input_names, [channels.output_names[o] for o in pools[0].outputs]
    first = distinct[0]
    return make_pool(
        Polynomial(
            outputs=first.outputs,
            input_lags=_union(
                [_lags_by_name(m.input_lags, names[0]) for m in distinct]
            ),
            output_lags=_union(
                [_lags_by_name(m.output_lags, names[1]) for m in distinct]
            ),
            filters=_all(m.filters for m in distinct),
            degree=max(m.degree for m in distinct),
            filter_lags=_all(m.filter_lags for m in distinct),
        ),
        channels,
    )


def terms_of(method: Polynomial | Pool, pool: Pool) -> Bool[np.ndarray, " terms"]:
    """True for the terms of a larger pool that the settings have."""
    own = make_pool(method, pool.channels)
    if own is pool:
        return np.ones(len(pool), bool)
    known = set(own.variables.entries)
    there = np.array([True, *(entry in known for entry in pool.variables.entries)])
    degree = np.count_nonzero(pool.factor, axis=1)
    return np.all(there[pool.factor], axis=1) & (degree <= own.degree)


def _lags_by_name(lags: Any, names: Iterable[str]) -> dict[str, Sequence[int]]:
    return dict(lags) if isinstance(lags, Mapping) else {name: lags for name in names}


def _union(tables: list[dict[str, Sequence[int]]]) -> dict[str, Sequence[int]]:
    names = dict.fromkeys(name for table in tables for name in table)
    return {
        name: sorted({lag for table in tables for lag in table.get(name, ())})
        for name in names
    }


def _all(rows: Iterable[Sequence[Any]]) -> tuple[Any, ...]:
    return tuple(dict.fromkeys(value for row in rows for value in row))
