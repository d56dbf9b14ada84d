"""Cost of one sample of a network: the arithmetic of its exported form."""

import collections
import dataclasses
from collections.abc import Callable, Iterable, Mapping

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.exporters import (
    BLEND,
    FILTERS,
    FRAME,
    TERMS,
    WEIGHTS,
    SampleProgram,
    count_stored_for_weights,
    lower,
)
from jaxnarx.formatting import align_columns, page
from jaxnarx.models import Network

COUNT_NAMES = {
    "mul": "multiplications",
    "add": "additions",
    "sub": "additions",
    "neg": "additions",
    "exp": "exponentials",
    "sqrt": "exponentials",
    "div": "divisions",
    "max": "comparisons",
    "min": "comparisons",
    "less": "comparisons",
    "where": "comparisons",
}
"""The count to which each kind of operation of an exported program adds."""


@dataclasses.dataclass(frozen=True)
class Operations:
    """Numbers of operations by kind. A subtraction and a change of sign are additions;
    a root is an exponential; the smaller or larger of two values and a choice are
    comparisons."""

    multiplications: int = 0
    additions: int = 0
    exponentials: int = 0
    divisions: int = 0
    comparisons: int = 0

    @property
    def total(self) -> int:
        """All together."""
        return sum(dataclasses.astuple(self))


@dataclasses.dataclass(frozen=True)
class Cost:
    """Operations of one sample by their purpose, and the size of the model.

    `frame` counts scales, limits, flags, and the replacement of missing inputs.
    `regressors` counts the terms of all local models, the constant left out;
    `parameters` all numbers to be stored: coefficients, constants among them, and those
    of the validity functions. In the cost of a network `outputs` holds each output's.
    """

    terms: Operations
    weights: Operations
    blend: Operations
    filters: Operations
    frame: Operations
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
        return {
            n: {title: get(c) for title, get in COST_COLUMNS} for n, c in rows.items()
        }

    @property
    def table(self) -> str:
        """`to_dict` as aligned text."""
        lines = [("", *(title for title, _ in COST_COLUMNS))]
        lines += [(n, *map(str, row.values())) for n, row in self.to_dict().items()]
        return "\n".join(align_columns(lines))

    @property
    def total(self) -> Operations:
        """All operations together."""
        parts = self.terms, self.weights, self.blend, self.filters, self.frame
        columns = zip(*map(dataclasses.astuple, parts), strict=True)
        return Operations(*map(sum, columns))

    @property
    def operations(self) -> int:
        """Their number, as exported code states it without the domain index."""
        return self.total.total


COST_COLUMNS: tuple[tuple[str, Callable[[Cost], int]], ...] = (
    ("models", lambda c: c.local_models),
    ("regressors", lambda c: c.regressors),
    ("parameters", lambda c: c.parameters),
    ("multiplications", lambda c: c.total.multiplications),
    ("of them terms", lambda c: c.terms.multiplications),
    ("additions", lambda c: c.total.additions),
    ("exponentials", lambda c: c.total.exponentials),
    ("divisions", lambda c: c.total.divisions),
    ("comparisons", lambda c: c.total.comparisons),
)
"""Sizes, and operations of one sample, as they are shown."""


@guard_arguments
def cost(network: Network) -> Cost:
    """Operations a control unit does at one sample, output by output and in total.

    The counts are those of the exported form (`jaxnarx.exporters.lower`), without the
    domain index and intervals: the operations that every target computes, products of
    variables that local models have in common formed once. Their purpose is that of
    whoever needs them first: the terms of the local models, the weights of these with
    the scaling of the scheduling, the blend, filters, and the frame of scales, limits
    and flags around them. The cost of one output holds what it alone would take; in the
    total what outputs have in common counts once.

    Args:
        network: The model. `SpecError` where its validity function cannot be exported.

    Returns:
        Operations by purpose and sizes of the model, `outputs` those of each output.

    Example:
        print(jnx.evaluation.cost(network))
    """
    program = lower(network, index=False, slopes=False)
    lines = [name for name, _ in program.past]
    outputs: dict[str, Cost] = {}
    for o, name in enumerate(network.computed_names):
        values = [program.fed[o], program.limited[o], *program.outputs[o : o + 1]]
        own = program.state_closure(values, without=lines)
        outputs[name] = _cost(program, own, _sizes(network, o), {})
    sizes = [
        (one.parameters, one.local_models, one.regressors) for one in outputs.values()
    ]
    parameters, local_models, regressors = map(sum, zip(*sizes, strict=True))
    whole = parameters, local_models, regressors
    return _cost(program, program.model_step(), whole, outputs)


def _cost(
    program: SampleProgram,
    values: Iterable[int],
    sizes: tuple[int, int, int],
    outputs: dict[str, Cost],
) -> Cost:
    """The cost of these operations, by their purpose."""
    ops = (program.ops[n] for n in values)
    counts = collections.Counter(
        (op.purpose, COUNT_NAMES[op.kind]) for op in ops if op.kind in COUNT_NAMES
    )

    def operations_for(purpose: str) -> Operations:
        kinds = (field.name for field in dataclasses.fields(Operations))
        return Operations(*(counts[purpose, kind] for kind in kinds))

    parameters, local_models, regressors = sizes
    return Cost(
        terms=operations_for(TERMS),
        weights=operations_for(WEIGHTS),
        blend=operations_for(BLEND),
        filters=operations_for(FILTERS),
        frame=operations_for(FRAME),
        parameters=parameters,
        local_models=local_models,
        regressors=regressors,
        outputs=outputs,
    )


def _sizes(network: Network, output: int) -> tuple[int, int, int]:
    """Parameters, local models and regressors of an output."""
    model = network.models[output]
    active = np.flatnonzero(np.asarray(model.active))
    constant = ~np.any(np.asarray(model.local.factor) != 0, axis=1)
    index, used = np.asarray(model.local.index), np.asarray(model.local.used)
    terms = [np.unique(index[m, used[m]]) for m in active]
    coefficients = sum(map(len, terms))
    constants = int(sum(constant[own].sum() for own in terms))
    stored = count_stored_for_weights(network, output)
    return coefficients + stored, len(active), coefficients - constants


@guard_arguments
def pareto(
    points: Float[np.ndarray, "points objectives"],
) -> Bool[np.ndarray, " points"]:
    """Mark the points that no other dominates; every objective is to be small.

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
