"""Operations of a sample: by hand, and by numbers that count what is done to them."""

import collections
import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from common import A, B, Part, Y, network

from jaxnarx.errors import SpecError
from jaxnarx.evaluation._cost import cost, local_terms
from jaxnarx.evaluation.operations import Operations, filtering, weighing
from jaxnarx.models import (
    AbstractValidity,
    Boxes,
    Compact,
    Gaussians,
    LocalModels,
    LogSigmoids,
    OutputModel,
    SigmoidTree,
)
from jaxnarx.regressors import (
    Kautz,
    LowPass,
    Variables,
    laguerre_bank,
    orthonormal_bank,
)

COUNTS = collections.Counter()


@dataclasses.dataclass
class Number:
    """A real number that counts: the slow, obvious way to know what a formula costs."""

    value: float

    def __add__(self, other):
        COUNTS["additions"] += 1
        return Number(self.value + other.value)

    def __sub__(self, other):
        COUNTS["additions"] += 1
        return Number(self.value - other.value)

    def __mul__(self, other):
        COUNTS["multiplications"] += 1
        return Number(self.value * other.value)

    def __truediv__(self, other):
        COUNTS["divisions"] += 1
        return Number(self.value / other.value)

    def __neg__(self):
        return Number(-self.value)

    def __lt__(self, other):
        COUNTS["comparisons"] += 1
        return self.value < other.value


ZERO, ONE = Number(0.0), Number(1.0)


def exp(a):
    COUNTS["exponentials"] += 1
    return Number(math.exp(a.value))


def sigmoid(a):
    return ONE / (ONE + exp(-a))


def total(numbers):
    out = numbers[0]
    for number in numbers[1:]:
        out = out + number
    return out


def largest(numbers):
    out = numbers[0]
    for number in numbers[1:]:
        out = number if out < number else out
    return out


# The three active models' weights in plain numbers, and what to divide the blend by -


def gaussians(f, z):
    logits = []
    for c, s in zip(np.asarray(f.centre)[:3], np.exp(f.log_width)[:3], strict=True):
        away = [
            (x - Number(c[d])) * Number(math.sqrt(0.5) / s[d]) for d, x in enumerate(z)
        ]
        logits.append(-total([a * a for a in away]))
    top = largest(logits)
    weights = [exp(a - top) for a in logits]
    return weights, total(weights)


def compact(f, z):
    low, high, margin = (np.asarray(p) for p in (f.low, f.high, jnp.exp(f.log_margin)))
    z = [largest([ZERO, -largest([-ONE, -x])]) for x in z]

    def flank(t):
        t = largest([ZERO, -largest([-ONE, -t])])
        inner = t * (Number(6.0) * t - Number(15.0)) + Number(10.0)
        return t * t * t * inner

    curves = []
    for m in range(3):
        flanks = []
        for d, x in enumerate(z):
            half = Number(0.5 / margin[m, d])
            flanks.append(flank((x - Number(low[m, d] - margin[m, d])) * half))
            flanks.append(flank((Number(high[m, d] + margin[m, d]) - x) * half))
        out = flanks[0]
        for one in flanks[1:]:
            out = out * one
        curves.append(out)
    whole = total(curves)
    assert ZERO < whole
    return curves, whole


def log_sigmoids(f, z):
    a = Number(math.exp(float(f.log_steepness)))
    gates = [sigmoid((z[0] - Number(b)) * a) for b in f.border.tolist()[:2]]
    inner = [one - two for one, two in zip(gates[:-1], gates[1:], strict=True)]
    return [ONE - gates[0], *inner, gates[-1]], None


def tree(f, z):
    """Two gates: the second divides the side where the first is open."""
    gates = []
    unit, border, steepness = map(np.asarray, (f.unit(), f.border, f.log_steepness))
    for g in range(2):
        slope = (unit[g] * np.exp(steepness[g])).tolist()
        along = total([Number(s) * x for s, x in zip(slope, z, strict=True) if s])
        gates.append(sigmoid(along - Number(border[g] * np.exp(steepness[g]))))
    inside = gates[0] * gates[1]
    return [ONE - gates[0], inside, gates[0] - inside], None


PLAIN = {Gaussians: gaussians, Compact: compact, LogSigmoids: log_sigmoids}
PLAIN[SigmoidTree] = tree

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
    start = network([], ())
    return dataclasses.replace(start, modelled=(0,), models=(model_of(validity),))


@pytest.fixture(scope="module", params=range(5))
def example(request):
    return whole(validities()[request.param])


def counted(net, v, z, products):
    """The output of a sample by counting numbers; `products` remembers or not."""
    model = net.models[0]
    weights, norm = PLAIN[type(model.validity)](model.validity, z)

    def product(term):
        if len(term) == 1:
            return v[term[0] - 1]
        if term in products:
            return products[term]
        out = product(term[:-1]) * v[term[-1] - 1]
        if products is not FORGETFUL:
            products[term] = out
        return out

    local = []
    for m, terms in enumerate(TERMS):
        theta = np.asarray(model.local.coefficient)[m]
        local.append(
            total(
                [
                    Number(theta[s]) * product(t) if t else Number(theta[s])
                    for s, t in enumerate(terms)
                ]
            )
        )
    y = total([w * one for w, one in zip(weights, local, strict=True)])
    return y if norm is None else y / norm


FORGETFUL: dict = {}


@eqx.filter_jit
def called(model, v, z):
    return model(v, z)


@pytest.mark.parametrize("example", [0, 2, 3, 4], indirect=True)  # boxes: below
@pytest.mark.parametrize("shared", [False, True])
def test_counts_are_those_of_numbers_that_count(example, shared):
    model = example.models[0]
    rng = np.random.default_rng(1)
    v, z = rng.normal(size=5), rng.uniform(size=len(model.offset))
    COUNTS.clear()
    products = {} if shared else FORGETFUL
    got = counted(example, list(map(Number, v)), list(map(Number, z)), products)
    expected = called(model, np.concatenate([[1.0], v]), z)
    # The count is worth something only where the formula is the network's.
    assert got.value == pytest.approx(float(expected), rel=1e-12)
    assert cost(example, shared=shared).total == Operations(**COUNTS)


BY_HAND = {
    # Per class: operations of the weights, and numbers stored for them.
    Gaussians: (Operations(12, 6 + 3 + 3 + 2, 3, 1, 2), 12),
    Boxes: (Operations(0, 12, 0, 0, 12 + 2), 12),
    Compact: (Operations(3 * 2 * 2 * 6 + 9, 3 * 12 + 2, 0, 1, 4 + 24 + 1), 18),
    LogSigmoids: (Operations(2, 6, 2, 2), 3),
    SigmoidTree: (Operations(3 + 1, 3 + 4, 2, 2), 5),
}


def test_weights_by_hand(example):
    validity = example.models[0].validity
    active = np.arange(4) < 3
    assert weighing(validity, active) == BY_HAND[type(validity)]
    one_box = isinstance(validity, Boxes)
    got = cost(example)
    # The costliest local model alone, or all of them and their blend.
    assert got.terms == (Operations(8, 3) if one_box else Operations(15, 6))
    assert got.blend == (Operations() if one_box else Operations(3, 2))
    assert (got.local_models, got.regressors) == (3, 7)
    assert got.parameters == 9 + BY_HAND[type(validity)][1]


def test_shared_products_are_formed_once():
    net = whole(validities()[0])
    # x1 x2, x1 x2 x3, x1 x2 x4, x3 x3, x3 x3 x3 and seven coefficients.
    assert cost(net, shared=True).terms == Operations(5 + 7, 6)
    assert local_terms(net.models[0]) == TERMS


def test_a_single_model_has_no_weights_and_a_linear_term_costs_one():
    part = Part([[((0,), 1.0), ((1,), 2.0), ((2,), 3.0)]])
    got = cost(network([part, part], (0, 1)))
    assert got.outputs["y"].total == Operations(2, 2)
    assert got.total == Operations(4, 4) and got.parameters == 6
    assert (got.multiplications, got.additions, got.exponentials) == (4, 4, 0)
    assert (got.divisions, got.comparisons, got.regressors) == (0, 0, 4)


def test_the_table_has_a_line_per_output_and_their_sum():
    part = Part([[((0,), 1.0), ((1,), 2.0), ((3,), 3.0)]])
    head, y, w, both = str(cost(network([part, part], (0, 1)))).splitlines()
    assert head.split()[:4] == ["models", "regressors", "parameters", "multiplications"]
    assert y.split() == ["y", "1", "2", "3", "2", "2", "2", "0", "0", "0"]
    assert both.split() == ["all", "2", "4", "6", "4", "4", "4", "0", "0", "0"]
    assert len({len(line) for line in (head, y, w, both)}) == 1


def test_filters_share_their_cascades():
    low = filtering([(A, LowPass(1.0))])
    assert low == Operations(2, 1)
    # Three sections of a Laguerre bank: three states, two of them passed on.
    bank = laguerre_bank(1.0, 3)
    assert filtering([(A, f) for f in bank]) == Operations(3 * 2 + 2 * 2, 3 + 2)
    assert filtering([(A, bank[2])]) == filtering([(A, f) for f in bank])
    # The first function is a first-order lag but for its gain; another signal is not.
    assert filtering([(A, bank[0]), (A, LowPass(1.0))]) == low
    assert filtering([(A, LowPass(1.0)), (B, LowPass(1.0))]) == low + low
    # A complex pair, both functions; then the pair before a real section.
    assert filtering([(A, Kautz(2.0, 0.5, k)) for k in (1, 2)]) == Operations(5, 3)
    mixed = orthonormal_bank((-1 + 2j, -3.0))
    assert filtering([(A, f) for f in mixed]) == Operations(5 + 3 + 2, 3 + 2 + 1)


def test_filters_of_unused_variables_cost_nothing_and_common_ones_once():
    table = Variables.of([(A, 0, LowPass(1.0)), (B, 0, LowPass(2.0)), (Y, 1, None)])
    part = Part([[((1,), 2.0), ((3,), 0.5)]])
    net = dataclasses.replace(network([part, part], (0, 1)), variables=table)
    got = cost(net)
    assert got.outputs["y"].filters == got.outputs["w"].filters == Operations(2, 1)
    assert got.filters == Operations(2, 1)
    assert got.multiplications == 2 + 2 + 2


def test_a_validity_without_a_rule_is_refused():
    unknown = weighing.dispatch(AbstractValidity)
    with pytest.raises(SpecError, match="no rule to count"):
        unknown(validities()[0], np.arange(4) < 3)
