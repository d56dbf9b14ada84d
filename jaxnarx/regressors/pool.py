"""Pools of polynomial terms as tables of integers; the one evaluation of a
regressor.
"""

import functools
import itertools
import math
import operator
from collections.abc import Mapping, Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require_known
from jaxnarx.data import Channels
from jaxnarx.errors import SpecError
from jaxnarx.formatting import page
from jaxnarx.regressors.filters import AbstractFilter, LowPass, require_filter
from jaxnarx.regressors.text import term_name, variable_names
from jaxnarx.regressors.variables import Entry, Variables

MOST_TERMS = 5_000_000
"""Terms a pool may hold; beyond that its index table alone takes over 100 MB."""

Lags = Sequence[int] | Mapping[str, Sequence[int]]
Bank = Sequence[AbstractFilter | float | int]
Filters = Bank | Mapping[str, Bank]


def evaluate(
    factor: Int[Array, "terms degree"] | Int[np.ndarray, "terms degree"],
    v: Float[Array | np.ndarray, "vars *rows"],
) -> Float[Array | np.ndarray, "terms *rows"]:
    """Values of polynomial terms, `v = [1, x_1 ... x_V]` at one sample or at many.

    The one evaluation of a regressor: design rows, simulation steps and derivatives are
    made from it. Samples, where there are several, are the trailing axes, so that a
    term is a product of contiguous rows; a `vmap` over samples would gather them one by
    one.
    """
    return functools.reduce(
        operator.mul, (v[factor[:, k]] for k in range(factor.shape[1]))
    )


class Pool(eqx.Module):
    """Candidate terms: rows of indices into `[1, x_1 ... x_V]`, 0 means "times one".

    `outputs` are the positions of the modelled outputs among `channels.outputs`.
    """

    variables: Variables = eqx.field(static=True)
    factor: Int[np.ndarray, "terms degree"]
    channels: Channels = eqx.field(static=True)
    outputs: tuple[int, ...] = eqx.field(static=True)

    def __str__(self) -> str:
        names = self.channels.output_names
        return (
            f"Pool: {len(self)} terms of up to {self.degree} factors, for "
            f"{', '.join(names[o] for o in self.outputs)}\n"
            f"  of {', '.join(self.variable_names)}"
        )

    _repr_html_ = page

    def __len__(self) -> int:
        return self.factor.shape[0]

    @property
    def degree(self) -> int:
        """Largest number of factors of a term."""
        return self.factor.shape[1]

    @property
    def variable_names(self) -> list[str]:
        """`speed[t-2]` for every lagged variable."""
        return variable_names(self.channels, self.variables)

    def name(self, term: int) -> str:
        """Text of one term, `"u1[t-2]*NOx[t-1]"`."""
        return term_name(self.variable_names, self.factor[term].tolist())

    @property
    def names(self) -> list[str]:
        """Texts of all terms. Long for large pools; prefer `name`."""
        variables = self.variable_names
        return [term_name(variables, row) for row in self.factor.tolist()]

    def of_output(self, place: int) -> "Pool":
        """The same candidates for one of the modelled outputs; others are measured."""
        return Pool(self.variables, self.factor, self.channels, (self.outputs[place],))


def _lags(
    lags: Lags, names: Sequence[str], *, lowest: int, kind: str
) -> list[list[int]]:
    field = f"{kind}_lags"
    if isinstance(lags, Mapping):
        for name in lags:
            require_known(
                name,
                names,
                field,
                f"{field} names {name!r}, which is not a modelled {kind}",
            )
        chosen = [list(lags.get(name, ())) for name in names]
    else:
        chosen = [list(lags)] * len(names)
    for name, row in zip(names, chosen, strict=True):
        for lag in row:
            if isinstance(lag, bool) or int(lag) != lag or lag < lowest:
                raise SpecError(
                    f"{field} of {name!r} must be whole numbers of at least {lowest}, "
                    f"got {lag!r}",
                    field=field,
                )
        if len(set(row)) != len(row):
            raise SpecError(f"{field} of {name!r} repeat: {row}", field=field)
    return [[int(lag) for lag in row] for row in chosen]


def _filtered_inputs(
    channels: Channels, filters: Filters | None, lags: Sequence[int]
) -> list[Entry]:
    """Filtered inputs, each at all lags."""
    if filters is None:
        return []
    inputs = channels.input_names
    if not isinstance(filters, Mapping):
        filters = {name: filters for name in inputs}
    by_name: dict[str, list[AbstractFilter]] = {}
    for name, bank in filters.items():
        require_known(
            name, inputs, "filters", f"filters names {name!r}, which is not an input"
        )
        by_name[name] = [_filter(each) for each in bank]
        if len(set(by_name[name])) != len(bank):
            raise SpecError(f"filters of {name!r} repeat: {bank}", field="filters")
    (lags,) = _lags(lags, ["inputs"], lowest=0, kind="filter")
    return [
        (channels.signal(name), lag, filter_)
        for name in inputs
        for filter_ in by_name.get(name, ())
        for lag in lags
    ]


def _filter(value: object) -> AbstractFilter:
    """A filter, or the first-order lag of a time constant."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return LowPass(float(value))
    return require_filter(value)


@guard_arguments
def polynomial_pool(
    channels: Channels,
    *,
    outputs: str | Sequence[str] | None = None,
    input_lags: Lags,
    output_lags: Lags,
    degree: int,
    filters: Filters | None = None,
    filter_lags: Sequence[int] = (0,),
) -> Pool:
    """All products of up to `degree` lagged variables, the constant among them.

    With V variables the pool has C(V + degree, degree) terms. The order of variables
    is: lagged inputs, filtered inputs, lagged outputs. Wrong names or lags raise
    `SpecError`.

    Args:
        channels: The channels of the data.
        outputs: Names of the modelled outputs (default: all); their lags are fed back
            in a free run.
        input_lags: Samples from 0, a tuple for all inputs or a dict by channel name
            (channels it leaves out get none).
        output_lags: Likewise from 1. Without any, `()`, the model has no feedback and
            cannot diverge.
        degree: Most factors of a term.
        filters: Filtered inputs as well, `LowPass(4.0)` and its like, which remember
            the inputs of long ago: a sequence for all inputs or a dict by channel name.
            A number is the time constant of a `LowPass` [s].
        filter_lags: Samples at which each of them enters.

    Returns:
        The pool, a table of variables and one of terms.

    Example:
        pool = jnx.polynomial_pool(
            data.channels, outputs=["y"], input_lags=(0, 1), output_lags=(1,), degree=2
        )
        print(len(pool.factor), "terms")
    """
    if isinstance(outputs, str):
        outputs = [outputs]
    chosen = list(outputs) if outputs is not None else channels.output_names
    for name in chosen:
        require_known(
            name, channels.output_names, "outputs", f"unknown output {name!r}"
        )
    if not 1 <= degree <= 4:
        raise SpecError(f"degree must be 1 to 4, got {degree}", field="degree")
    rows: list[Entry] = []
    inputs = channels.input_names
    for name, lags in zip(
        inputs, _lags(input_lags, inputs, lowest=0, kind="input"), strict=True
    ):
        rows += [(channels.signal(name), lag, None) for lag in lags]
    rows += _filtered_inputs(channels, filters, filter_lags)
    for name, lags in zip(
        chosen, _lags(output_lags, chosen, lowest=1, kind="output"), strict=True
    ):
        rows += [(channels.signal(name), lag, None) for lag in lags]
    if not rows:
        raise SpecError(
            "no lagged variables: give input_lags, output_lags or filters",
            field="input_lags",
        )
    size = math.comb(len(rows) + degree, degree)
    if size > MOST_TERMS:
        raise SpecError(
            f"{len(rows)} lagged variables at degree {degree} make {size:,} terms, "
            f"more than {MOST_TERMS:,}; use fewer lags or a lower degree",
            field="degree",
        )
    factor = np.fromiter(
        itertools.chain.from_iterable(
            itertools.combinations_with_replacement(range(len(rows) + 1), degree)
        ),
        dtype=np.int32,
        count=size * degree,
    ).reshape(size, degree)
    positions = tuple(channels.output_names.index(name) for name in chosen)
    return Pool(Variables.of(rows), factor, channels, positions)
