"""The table of an order search: errors and criteria of every structure."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxnarx.arrays import information
from jaxnarx.checks import choice
from jaxnarx.formatting import page
from jaxnarx.linear.triangle import Triangle
from jaxnarx.settings import ARX

CRITERIA = ("aic", "aicc", "mdl", "fpe", "unexplained")

ROUNDING_SHARE = 1e-20
"""Share of the output's sum of squares below which errors are rounding: without noise
all structures that hold the true one fit alike, and the smallest is to win."""


@dataclasses.dataclass(frozen=True, eq=False)
class OrderSearch:
    """ARX structures on common samples, one per place of every array.

    `unexplained` is the sum of squared one-step errors in percent of that of the output
    about its mean (figure 4.4). `parameters` counts a's and b's. With N samples and n
    parameters, a constant among them where there is one: aic = N ln(SSE/N) + 2 n, aicc
    = aic + 2 n (n + 1) / (N - n - 1), mdl (Rissanen's, also called BIC) = N ln(SSE/N) +
    n ln N, fpe = N ln(SSE/N) + N ln((N + n)/(N - n)). Smaller is better in all.
    """

    na: Int[np.ndarray, " structures"]
    nb: Int[np.ndarray, "structures inputs"]
    nk: Int[np.ndarray, "structures inputs"]
    parameters: Int[np.ndarray, " structures"]
    unexplained: Float[np.ndarray, " structures"]
    aic: Float[np.ndarray, " structures"]
    aicc: Float[np.ndarray, " structures"]
    mdl: Float[np.ndarray, " structures"]
    fpe: Float[np.ndarray, " structures"]
    identifiable: Bool[np.ndarray, " structures"]
    samples: int
    input_names: tuple[str, ...]
    constant: bool

    def __len__(self) -> int:
        return len(self.na)

    def best_place(self, criterion: str = "mdl") -> int:
        """Place of the best structure by "aic", "aicc", "mdl", "fpe" or
        "unexplained".
        """
        choice(criterion, CRITERIA, "criterion")
        score = np.where(self.identifiable, getattr(self, criterion), np.inf)
        ties = np.flatnonzero(score == score.min())
        return int(ties[np.argmin(self.parameters[ties])])

    def best(self, criterion: str = "mdl") -> ARX:
        """Settings of the best structure, for `fit_linear`."""
        return self.method(self.best_place(criterion))

    def method(self, place: int) -> ARX:
        """Settings of the structure at a place."""
        nb = dict(zip(self.input_names, self.nb[place].tolist(), strict=True))
        nk = dict(zip(self.input_names, self.nk[place].tolist(), strict=True))
        na = int(self.na[place])
        if len(nb) == 1:
            # One number reads better, and means the same where it is the only input.
            (nb,), (nk,) = nb.values(), nk.values()
        return ARX(na, nb, nk, constant=self.constant)

    def orders(self, place: int) -> tuple[int | tuple[int, ...], ...]:
        """(n_a, n_b, n_k) at a place; a tuple each of n_b and n_k by several inputs."""
        nb, nk = tuple(self.nb[place].tolist()), tuple(self.nk[place].tolist())
        if len(nb) == 1:
            return int(self.na[place]), nb[0], nk[0]
        return int(self.na[place]), nb, nk

    @property
    def frontier(self) -> Int[np.ndarray, " sizes"]:
        """Places of the best fits of every number of parameters, by rising number."""
        order = np.lexsort((self.unexplained, ~self.identifiable, self.parameters))
        first = np.unique(self.parameters[order], return_index=True)[1]
        chosen = order[first]
        return chosen[self.identifiable[chosen]]

    @property
    def table(self) -> list[dict[str, Any]]:
        """The frontier as rows: parameters, orders, unexplained [%] and criteria."""
        return [
            {
                "parameters": int(self.parameters[n]),
                "orders": self.orders(int(n)),
                **{name: float(getattr(self, name)[n]) for name in CRITERIA},
            }
            for n in self.frontier
        ]

    def __str__(self) -> str:
        """The frontier as text, the best by each criterion marked."""
        best = {name: self.best_place(name) for name in ("aic", "mdl", "fpe")}
        lines = [f"{len(self)} structures on {self.samples} samples"]
        lines += ["parameters  unexplained [%]  n_a, n_b, n_k"]
        for n, row in zip(self.frontier.tolist(), self.table, strict=True):
            marks = ", ".join(name for name, place in best.items() if place == n)
            figures = f"{row['parameters']:10d}  {row['unexplained']:15.6g}"
            text = ", ".join(map(str, row["orders"]))
            lines.append(f"{figures}  {text}{f'  <- {marks}' if marks else ''}")
        return "\n".join(lines)

    _repr_html_ = page


def order_search(
    orders: Int[np.ndarray, "structures orders"],
    sse: Float[np.ndarray, " structures"],
    identifiable: Bool[np.ndarray, " structures"],
    table: Triangle,
    input_names: Sequence[str],
) -> OrderSearch:
    """Criteria from sums of squared errors; `orders` holds n_a, all n_b, all n_k."""
    inputs = len(input_names)
    na, nb, nk = orders[:, 0], orders[:, 1 : 1 + inputs], orders[:, 1 + inputs :]
    samples = table.samples
    parameters = na + nb.sum(axis=1)
    n = parameters + int(table.constant)
    found = information(sse, n, samples, least=ROUNDING_SHARE * table.total)
    return OrderSearch(
        na,
        nb,
        nk,
        parameters,
        100 * sse / table.total,
        found["aic"],
        found["aicc"],
        found["bic"],
        found["fpe"],
        identifiable,
        samples,
        tuple(input_names),
        table.constant,
    )
