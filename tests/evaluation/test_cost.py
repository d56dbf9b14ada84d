"""Operations of a sample: by hand, and as exported code states them."""

import dataclasses

import common
import jax.numpy as jnp
import numpy as np
import pytest
from common import A, B, Part, Y, network

from jaxnarx.errors import SpecError
from jaxnarx.evaluation._cost import Operations, cost
from jaxnarx.exporters import lower
from jaxnarx.models import (
    Boxes,
    Compact,
    Gaussians,
    LocalModels,
    LogSigmoids,
    OutputModel,
    SigmoidTree,
)
from jaxnarx.regressors import (
    AbstractFilter,
    Kautz,
    LowPass,
    Variables,
    laguerre_bank,
    orthonormal_bank,
)

LOW = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.5]])
HIGH = np.array([[0.5, 1.0], [1.0, 0.5], [1.0, 1.0]])


def padded(values, fill=0.3):
    return jnp.asarray(np.concatenate([values, np.full((1, *values.shape[1:]), fill)]))


def validities():
    """Three models and a spare one; the tree has a straight and an oblique gate."""
    centre, width = padded((LOW + HIGH) / 2), padded(np.log((HIGH - LOW) / 3))
    low, high = padded(LOW), padded(HIGH)
    gates = jnp.array([[1.0, 0.0], [0.6, -0.8], [0.0, 0.0]])
    path = jnp.array([[-1, 0, 0], [1, 1, 0], [1, -1, 0], [0, 0, 1]])
    borders = jnp.array([0.5, 0.1, 0.7])
    return [
        Gaussians(centre, width),
        Boxes(low, high),
        Compact(low, high, jnp.full((4, 2), -1.5)),
        LogSigmoids(jnp.array([0.3, 0.6, 0.7]), jnp.asarray(2.0)),
        SigmoidTree(gates, borders, jnp.array([2.0, 2.5, 1.0]), path),
    ]


TERMS = [[(), (1,), (1, 2)], [(2,), (1, 2, 3)], [(), (1, 2), (1, 2, 4), (3, 3, 3)]]
"""By hand: 0 + 1 + 2, 1 + 3 and 0 + 2 + 3 + 3 multiplications; 2, 1 and 3 sums."""


def model_of(validity) -> OutputModel:
    rows = sorted({t for terms in TERMS for t in terms})
    factor = jnp.array([(0,) * (3 - len(t)) + t for t in rows])
    index, used = np.zeros((4, 5), int), np.zeros((4, 5), bool)
    for m, terms in enumerate(TERMS):
        index[m, : len(terms)] = [rows.index(t) for t in terms]
        used[m, : len(terms)] = True
    used[3] = True
    coefficient = jnp.asarray(np.random.default_rng(3).normal(size=(4, 5)))
    local = LocalModels(factor, jnp.asarray(index), jnp.asarray(used), coefficient)
    dims = 1 if isinstance(validity, LogSigmoids) else 2
    scheduling = Variables(((A, 0), (B, 1))[:dims])
    active = jnp.arange(4) < 3
    scale = jnp.zeros(dims), jnp.ones(dims)
    return OutputModel(scheduling, *scale, validity, active, local)


def whole(validity):
    start = network([Part([[((0,), 1.0)]])], (0,))
    return dataclasses.replace(start, models=(model_of(validity),))


@pytest.fixture(scope="module", params=range(5))
def example(request):
    return whole(validities()[request.param])


@pytest.mark.parametrize("kind", common.KINDS)
def test_the_sum_is_what_exported_code_states(kind):
    net = common.named(kind)
    price = cost(net)
    assert price.operations == lower(net, index=False).operations
    assert price.operations == lower(net, index=True).model_operations
    assert price.total.total == price.operations
    parts = [one.operations for one in price.outputs.values()]
    # Flags are of the model alone; what outputs have in common counts once.
    assert max(parts) < price.operations < sum(parts) + 25


BY_HAND = {
    # Three models over two variables: operations of the weights, of the blend, and
    # numbers stored. Every model: differences, scales, squares, their sum and its half;
    # then the largest, differences from it, exponentials, their sum.
    Gaussians: (
        Operations(2 + 3 * (2 + 2 + 1), 2 + 3 * (2 + 1) + 3 + 2, 3, 0, 2),
        Operations(3, 2, 0, 1),
        12,
    ),
    # Distances from four borders and zero; the nearest; which one that is.
    Boxes: (Operations(2, 2 + 12, 0, 0, 3 * 4 + 2 + 3 * 2 + 2), Operations(3, 2), 12),
    # Twelve flanks, products of four, their sum; boxes where it vanishes.
    Compact: (
        Operations(2 + 12 * 6 + 3 * 3, 2 + 12 * 4 + 2 + 12, 0, 0, 4 + 24 + 22 + 5),
        Operations(3, 2, 0, 1),
        18,
    ),
    # Two gates: a difference, a scale and a sigmoid with a change of sign.
    LogSigmoids: (Operations(1 + 2, 1 + 2 * 3 + 2 + 0, 2, 2), Operations(3, 2), 3),
    # Two gates: products with both variables, one of them zero, their sum, the border,
    # its sign, limits, a sigmoid and its other side; two leaves have both gates.
    SigmoidTree: (
        Operations(2 + 2 * (2 + 1) + 2, 2 + 2 * (1 + 1 + 1 + 1), 2, 2, 4),
        Operations(3, 2),
        5,
    ),
}


def test_weights_by_hand(example):
    weights, blend, stored = BY_HAND[type(example.models[0].validity)]
    price = cost(example)
    assert (price.weights, price.blend) == (weights, blend)
    assert (price.local_models, price.regressors) == (3, 7)
    assert price.parameters == 9 + stored


def test_products_are_formed_once_and_a_constant_costs_nothing():
    # x1 x2, x1 x2 x3, x1 x2 x4, x3 x3, x3 x3 x3 and seven coefficients.
    assert cost(whole(validities()[0])).terms == Operations(5 + 7, 6)


def test_a_single_model_has_no_weights_and_a_linear_term_costs_one():
    part = Part([[((0,), 1.0), ((1,), 2.0), ((2,), 3.0)]])
    price = cost(network([part, part], (0, 1)))
    assert price.outputs["y"].terms == Operations(3 - 1, 2)
    assert price.weights == price.blend == price.filters == Operations()
    assert (price.parameters, price.regressors) == (6, 4)


def test_the_table_has_a_line_per_output_and_their_sum():
    part = Part([[((0,), 1.0), ((1,), 2.0), ((3,), 3.0)]])
    price = cost(network([part, part], (0, 1)))
    lines = str(price).splitlines()
    assert lines[0].split()[:4] == [
        "models",
        "regressors",
        "parameters",
        "multiplications",
    ]
    y, w, both = (line.split() for line in lines[1:])
    assert (y[:4], w[0]) == (["y", "1", "2", "3"], "w")
    assert both[:4] == ["all", "2", "4", "6"]
    assert int(both[4]) == price.total.multiplications
    assert len({len(line) for line in lines}) == 1


def filtered(*pairs: tuple[int, AbstractFilter]) -> Operations:
    """Of a network with a linear term of each filtered signal."""
    table = Variables.of([(s, 0, f) for s, f in pairs])
    part = Part([[((n,), 0.5) for n in range(1, len(pairs) + 1)]])
    return cost(dataclasses.replace(network([part], (0,)), variables=table)).filters


def test_filters_share_their_cascades():
    low = filtered((A, LowPass(1.0)))
    # x' = a x + b u, and what is seen of it is c x'.
    assert low == Operations(3, 1)
    assert filtered((A, LowPass(1.0)), (B, LowPass(1.0))) == Operations(6, 2)
    bank = laguerre_bank(1.0, 3)
    three = filtered(*((A, f) for f in bank))
    assert filtered((A, bank[2])) == three  # the last one has gone through all
    once = sum(filtered((A, f)).multiplications for f in bank)
    assert three.multiplications < once
    pair = filtered(*((A, Kautz(2.0, 0.5, k)) for k in (1, 2)))
    assert pair.additions < sum(
        filtered((A, Kautz(2.0, 0.5, k))).additions for k in (1, 2)
    )
    assert filtered(*((A, f) for f in orthonormal_bank((-1 + 2j, -3.0)))).additions > 0


def test_filters_of_unused_variables_cost_nothing_and_common_ones_once():
    table = Variables.of([(A, 0, LowPass(1.0)), (B, 0, LowPass(2.0)), (Y, 1, None)])
    part = Part([[((1,), 2.0), ((3,), 0.5)]])
    net = dataclasses.replace(network([part, part], (0, 1)), variables=table)
    price = cost(net)
    assert price.outputs["y"].filters == price.outputs["w"].filters == price.filters
    assert price.filters == Operations(3, 1)


def test_a_validity_that_cannot_be_exported_is_refused():
    class Own(Gaussians):
        pass

    centre = jnp.zeros((4, 2))
    with pytest.raises(SpecError, match="Own cannot be exported"):
        cost(whole(Own(centre, centre)))
