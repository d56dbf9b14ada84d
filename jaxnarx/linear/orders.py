"""Orders and delays of ARX models: every structure of a grid from one factorisation.

All structures are scored on the same samples, those with a complete window for the
largest, so that their errors can be compared. After one QR factorisation of all lags
(`triangle`) a structure is a subset of 31 columns of 31 rows, say. These subsets are
put in an order in which those of n_b = 1, 2, ... coefficients are nested: one small
factorisation of them, with the output as its last column, gives the errors of all, for
what the first k columns leave is what stands below row k of the last one.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from numbers import Integral

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear.order_table import OrderSearch, order_search
from jaxnarx.linear.structure import orders_by_input
from jaxnarx.linear.triangle import Triangle, triangle
from jaxnarx.solution import RESULTS, Solution

MOST_STRUCTURES = 200_000
"""Structures of one search."""

Lengths = Sequence[int] | Mapping[str, Sequence[int]]
"""Candidates for every input, or by input name."""


@guard_arguments
def search_orders(
    data: Dataset,
    *,
    na: Sequence[int] = range(1, 11),
    nb: Lengths = range(1, 11),
    nk: Lengths = range(1, 11),
    output: str | None = None,
    constant: bool = True,
    together: bool = False,
) -> Solution[OrderSearch]:
    """Fit ARX models of all combinations of n_a, n_b and n_k, as in figure 4.4.

    `nb` and `nk` are candidates for every input, or by input name; inputs a mapping of
    `nb` leaves out take no part. With several inputs each has its own, all combined;
    `together` gives all the same, which is far fewer. `output` names the output where
    there are several; `constant` adds one to every model.

    Structures whose columns are linearly dependent have `identifiable` False and are
    never the best; when all are, the status is `unidentifiable`. Too few samples for
    the largest structure raise `DataError`.

    Reference: L. Ljung, System Identification: Theory for the User, 2nd ed. 1999,
    chapter 16.4.
    """
    place = output_place(data, output)
    grid = _Grid.of(data, na, nb, nk, together=together)
    own = len(data.channels.inputs) + place
    rows = [(own, k) for k in range(1, max(grid.na) + 1)]
    for signal, lags in zip(grid.inputs, grid.lags(), strict=True):
        rows += [(signal, k) for k in lags]
    longest = max((lag for _, lag in rows), default=0)
    need = len(rows) + int(constant) + 1
    table = triangle(data, place, rows, history=longest, constant=constant, need=need)
    require_varying(table, data.channels.output_names[place])
    where = {row: n for n, row in enumerate(rows)}
    orders, sse, good = [], [], []
    for one in grid.chains():
        found = _chain(table, [[where[r] for r in c] for c in one.columns(own)], one)
        for part, piece in zip((orders, sse, good), found, strict=True):
            part.append(piece)
    names = [data.channels.input_names[i] for i in grid.inputs]
    value = order_search(
        np.concatenate(orders),
        np.concatenate(sse),
        np.concatenate(good),
        table,
        names,
    )
    return _solution(value, data, grid, rows, table)


def _solution(value: OrderSearch, data, grid, rows, table: Triangle) -> Solution:
    stats = {"structures": len(value), "samples": table.samples}
    if value.identifiable.any():
        return Solution(value, RESULTS.ok, stats)
    still = [
        data.channels.input_names[i]
        for i in grid.inputs
        if all(table.norm[n] == 0 for n, (s, _) in enumerate(rows) if s == i)
    ]
    what = f"input {still[0]!r} is constant" if still else "all columns are dependent"
    detail = f"no structure of the grid can be told from the data: {what}"
    return Solution(value, RESULTS.unidentifiable, stats, detail)


def output_place(data: Dataset, output: str | None) -> int:
    """Position of the named output; of the only one where none is named."""
    names = data.channels.output_names
    if output is None and len(names) == 1:
        return 0
    if output not in names:
        raise SpecError(
            f"output={output!r} is no output of the data; name one of {names}",
            field="output",
        )
    return names.index(output)


def require_varying(table: Triangle, name: str) -> None:
    """DataError where the output is constant (or zero, without a constant term)."""
    if table.norm[-1] == 0:
        raise DataError(
            f"{name} is constant over all usable samples: there is nothing to model",
            channel=name,
        )


@dataclasses.dataclass(frozen=True)
class _Chain:
    """Structures nested in the last input's n_b, at several delays each.

    `before` are the n_b of the inputs before it, `nb` its own, `nk` the delays of all.
    """

    inputs: tuple[int, ...]
    na: int
    before: tuple[int, ...]
    nb: tuple[int, ...]
    nk: tuple[tuple[int, ...], ...]
    together: bool

    def columns(self, own: int) -> list[list[tuple[int, int]]]:
        """(signal, lag) of the longest structure of every delay, in nested order."""
        return [self._one(own, delays) for delays in self.nk]

    def _one(self, own: int, delays: tuple[int, ...]) -> list[tuple[int, int]]:
        rows = [(own, k) for k in range(1, self.na + 1)]
        if self.together:
            return rows + [
                (s, d + k)
                for k in range(max(self.nb))
                for s, d in zip(self.inputs, delays, strict=True)
            ]
        lengths = (*self.before, max(self.nb, default=0))
        for signal, delay, length in zip(self.inputs, delays, lengths, strict=False):
            rows += [(signal, delay + k) for k in range(length)]
        return rows

    def size(self, nb: int) -> int:
        """Columns of the structure with this n_b."""
        if self.together:
            return self.na + nb * len(self.inputs)
        return self.na + sum(self.before) + nb

    def orders(self) -> Int[np.ndarray, "delays lengths orders"]:
        """n_a, n_b of every input, n_k of every input."""

        def one(nb: int, delays: tuple[int, ...]) -> tuple[int, ...]:
            if not self.inputs:
                return (self.na,)
            same = (nb,) * len(self.inputs)
            lengths = same if self.together else (*self.before, nb)
            return (self.na, *lengths, *delays)

        return np.array([[one(nb, d) for nb in self.nb] for d in self.nk])


def _chain(
    table: Triangle, columns: list[list[int]], chain: _Chain
) -> tuple[
    Int[np.ndarray, "structures orders"],
    Float[np.ndarray, " structures"],
    Bool[np.ndarray, " structures"],
]:
    """Orders, sums of squared errors, and whether the columns are independent."""
    sizes = np.array([chain.size(nb) for nb in chain.nb])
    use = np.array([[*c, table.r.shape[1] - 1] for c in columns])
    r = np.asarray(np.linalg.qr(np.moveaxis(table.r[:, use], 1, 0), mode="r"))
    left = np.cumsum((r[:, ::-1, -1]) ** 2, axis=1)[:, ::-1]
    diagonal = np.abs(np.diagonal(r, axis1=1, axis2=2))[:, : use.shape[1] - 1]
    free = diagonal > table.samples * np.finfo(float).eps
    whole = np.concatenate(
        [np.ones((len(use), 1), bool), np.logical_and.accumulate(free, axis=1)], axis=1
    )
    good = whole[:, sizes]
    sse = left[:, sizes] * table.total
    # Behind a dependent column the triangle explains by rounding; solve these anew.
    for d, n in zip(*np.nonzero(~good), strict=True):
        sse[d, n] = table.solve(columns[d][: sizes[n]]).sse
    orders = chain.orders()
    return orders.reshape(-1, orders.shape[-1]), sse.reshape(-1), good.reshape(-1)


@dataclasses.dataclass(frozen=True)
class _Grid:
    """Candidates of every order."""

    inputs: tuple[int, ...]
    na: tuple[int, ...]
    nb: tuple[tuple[int, ...], ...]
    nk: tuple[tuple[int, ...], ...]
    together: bool

    @classmethod
    def of(cls, data: Dataset, na, nb, nk, *, together: bool) -> "_Grid":
        names = data.channels.input_names
        lengths = _candidates_by_input(nb, names, "nb", 1)
        used = tuple(i for i, n in enumerate(lengths) if n is not None)
        delays = _candidates_by_input(nk, names, "nk", 0)
        if any(delays[i] is None for i in used):
            raise SpecError("nk must speak of every input that nb names", field="nk")
        chosen = tuple(lengths[i] or () for i in used)
        later = tuple(delays[i] or () for i in used)
        if together and len(set(chosen)) + len(set(later)) > 2:
            raise SpecError(
                "together=True takes one range for all inputs", field="together"
            )
        grid = cls(used, _candidates(na, "na", 0), chosen, later, together)
        if not used and grid.na == (0,):
            raise SpecError("there is no input, and na allows 0 only", field="na")
        count = grid.count()
        if count > MOST_STRUCTURES:
            raise SpecError(
                f"the grid has {count:,} structures, more than {MOST_STRUCTURES:,}; "
                "give narrower ranges, or together=True for the same orders of all "
                "inputs",
                field="nb",
            )
        return grid

    def count(self) -> int:
        """Structures of the grid."""
        take = slice(0, 1) if self.together else slice(None)
        sizes = [len(r) for r in (*self.nb[take], *self.nk[take])]
        return len(self.na) * int(np.prod(sizes, dtype=float))

    def lags(self) -> list[range]:
        """Lags of every input that any structure has."""
        pairs = zip(self.nb, self.nk, strict=True)
        return [range(min(nk), max(nk) + max(nb)) for nb, nk in pairs]

    def chains(self) -> Iterator[_Chain]:
        """Groups of structures that share a factorisation."""
        if not self.inputs:
            for na in self.na:
                yield _Chain((), na, (), (0,), ((),), False)
            return
        if self.together:
            nk = [(k,) * len(self.inputs) for k in self.nk[0]]
        else:
            nk = list(itertools.product(*self.nk))
        earlier = [()] if self.together else list(itertools.product(*self.nb[:-1]))
        for na, before in itertools.product(self.na, earlier):
            yield _Chain(self.inputs, na, before, self.nb[-1], tuple(nk), self.together)


def _candidates_by_input(given: Lengths, names: list[str], field: str, least: int):
    """A tuple of candidates for every input, None for those left out."""
    if not isinstance(given, Mapping):
        return [_candidates(given, field, least)] * len(names)
    orders_by_input({name: 0 for name in given}, names, field)
    return [
        _candidates(given[name], field, least) if name in given else None
        for name in names
    ]


def _candidates(values: Sequence[int], field: str, least: int) -> tuple[int, ...]:
    fine = all(isinstance(v, Integral) and v >= least for v in values)
    if not len(values) or not fine:
        raise SpecError(
            f"{field} must hold whole numbers of at least {least}, got {values}",
            field=field,
        )
    return tuple(sorted({int(v) for v in values}))
