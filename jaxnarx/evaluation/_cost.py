"""What one sample of a network costs: the arithmetic a control unit would do."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.evaluation.operations import NONE, Operations, filtering, weighing
from jaxnarx.guard import guarded
from jaxnarx.models import Boxes, Network, OutputModel
from jaxnarx.regressors import AbstractFilter
from jaxnarx.shown import aligned, page

Term = tuple[int, ...]
"""Variables of a product in ascending order, from 1; empty: the constant."""


@dataclasses.dataclass(frozen=True)
class Cost:
    """Operations of one sample by their purpose, and the size of the model.

    `regressors` counts the terms of all local models, the constant left out;
    `parameters` all numbers to be stored: coefficients, constants among them, and those
    of the validity functions. In the cost of a network `outputs` holds each output's.
    """

    terms: Operations
    weights: Operations
    blend: Operations
    filters: Operations
    parameters: int
    local_models: int
    regressors: int
    outputs: Mapping[str, "Cost"] = dataclasses.field(default_factory=dict)

    def __str__(self) -> str:
        return self.table

    _repr_html_ = page

    def to_dict(self) -> dict[str, dict[str, int]]:
        """Sizes and operations by output, and of `all` where there are several."""
        rows = dict(self.outputs)
        if len(rows) != 1:
            rows["all"] = self
        return {n: {title: get(c) for title, get in COLUMNS} for n, c in rows.items()}

    @property
    def table(self) -> str:
        """`to_dict` as aligned text."""
        lines = [("", *(title for title, _ in COLUMNS))]
        lines += [(n, *map(str, row.values())) for n, row in self.to_dict().items()]
        return "\n".join(aligned(lines))

    @property
    def total(self) -> Operations:
        """All operations together."""
        return self.terms + self.weights + self.blend + self.filters

    @property
    def multiplications(self) -> int:
        """Of terms, weights, blend and filters."""
        return self.total.multiplications

    @property
    def additions(self) -> int:
        """Additions and subtractions."""
        return self.total.additions

    @property
    def exponentials(self) -> int:
        """Of the validity functions."""
        return self.total.exponentials

    @property
    def divisions(self) -> int:
        """Of the validity functions."""
        return self.total.divisions

    @property
    def comparisons(self) -> int:
        """Of the validity functions."""
        return self.total.comparisons


COLUMNS: tuple[tuple[str, Callable[[Cost], int]], ...] = (
    ("models", lambda c: c.local_models),
    ("regressors", lambda c: c.regressors),
    ("parameters", lambda c: c.parameters),
    ("multiplications", lambda c: c.multiplications),
    ("of them terms", lambda c: c.terms.multiplications),
    ("additions", lambda c: c.additions),
    ("exponentials", lambda c: c.exponentials),
    ("divisions", lambda c: c.divisions),
    ("comparisons", lambda c: c.comparisons),
)
"""Sizes, and operations of one sample, as they are shown."""


@guarded
def cost(network: Network, *, shared: bool = False) -> Cost:
    """Operations a control unit does at one sample, output by output and in total.

    - terms: a multiplication for a linear term, two for a product of two variables,
      three for one of three, none for the constant, in each local model that has the
      term (thesis, section 6.3); n terms take n - 1 additions. Coefficients belong to
      physical units, so nothing is scaled;
    - weights: see `weighing`; none for a single local model;
    - blend: a multiplication per local model, and their sum;
    - filters: see `filtering`; what outputs have in common counts once in the total.

    With `Boxes` one local model speaks at a time: there is no blend, and terms are
    those of the costliest one. Shifting the past and limiting the feedback is not
    counted.

    Args:
        network: The model.
        shared: A product of variables is formed once for all local models of its
            output, from the product of its first factors, and each use takes the one
            multiplication by the coefficient.

    Returns:
        Operations by purpose and sizes of the model, `outputs` those of each output.

    Example:
        print(jnx.evaluation.cost(network, shared=True))
    """
    outputs = {
        name: _output(network, model, shared)
        for name, model in zip(network.computed_names, network.models, strict=True)
    }
    pairs = [pair for m in network.models for pair in _filters(network, m)]
    parts = list(outputs.values())
    return Cost(
        terms=sum((c.terms for c in parts), NONE),
        weights=sum((c.weights for c in parts), NONE),
        blend=sum((c.blend for c in parts), NONE),
        filters=filtering(pairs),
        parameters=sum(c.parameters for c in parts),
        local_models=sum(c.local_models for c in parts),
        regressors=sum(c.regressors for c in parts),
        outputs=outputs,
    )


def _output(network: Network, model: OutputModel, shared: bool) -> Cost:
    local = local_terms(model)
    coefficients = sum(map(len, local))
    weights, stored, blend, work = NONE, 0, NONE, _terms(local, shared)
    if len(local) > 1:
        weights, stored = weighing(model.validity, np.asarray(model.active))
        blend = Operations(multiplications=len(local), additions=len(local) - 1)
        if isinstance(model.validity, Boxes):
            alone = [_terms([terms], shared) for terms in local]
            blend, work = NONE, max(alone, key=dataclasses.astuple)
    return Cost(
        terms=work,
        weights=weights,
        blend=blend,
        filters=filtering(_filters(network, model)),
        parameters=coefficients + stored,
        local_models=len(local),
        regressors=coefficients - sum(terms.count(()) for terms in local),
    )


def local_terms(model: OutputModel) -> list[list[Term]]:
    """The distinct terms of every active local model."""
    factor, index = np.asarray(model.local.factor), np.asarray(model.local.index)
    used = np.asarray(model.local.used)
    rows = [tuple(sorted(v for v in row if v)) for row in factor.tolist()]
    return [
        list(dict.fromkeys(rows[i] for i in index[m, used[m]].tolist()))
        for m in np.flatnonzero(np.asarray(model.active)).tolist()
    ]


def _terms(local: list[list[Term]], shared: bool) -> Operations:
    additions = sum(max(len(terms) - 1, 0) for terms in local)
    if not shared:
        return Operations(sum(len(t) for terms in local for t in terms), additions)
    coefficients = sum(1 for terms in local for t in terms if t)
    products = {t[:n] for terms in local for t in terms for n in range(2, len(t) + 1)}
    return Operations(coefficients + len(products), additions)


def _filters(
    network: Network, model: OutputModel
) -> Iterable[tuple[int, AbstractFilter]]:
    """(signal, filter) of every filtered variable in a term or in the scheduling."""
    used = {v for terms in local_terms(model) for term in terms for v in term}
    entries = [network.variables.entries[v - 1] for v in sorted(used)]
    entries += model.scheduling.entries
    return [(s, f) for s, _, f in entries if f is not None]


@guarded
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
