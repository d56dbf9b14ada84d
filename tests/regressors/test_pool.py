"""Pools as tables: which terms they hold, what these evaluate to, what is refused."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import full_pool, term_matrix

from jaxnarx.data import Channel, Channels
from jaxnarx.errors import SpecError
from jaxnarx.regressors import LowPass, Variables, evaluate, polynomial_pool

CHANNELS = Channels(
    (Channel("speed", "rpm"), Channel("load")), (Channel("NOx", "ppm"), Channel("HC"))
)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_a_pool_holds_every_monomial_once(degree):
    pool = polynomial_pool(
        CHANNELS, input_lags=(0, 2), output_lags=(1, 3), degree=degree
    )
    variables = 2 * 2 + 2 * 2
    assert len(pool) == math.comb(variables + degree, degree)
    assert pool.degree == degree
    rows = {tuple(sorted(row)) for row in pool.factor.tolist()}
    assert rows == set(map(tuple, full_pool(variables, degree).tolist()))
    assert len(set(pool.names)) == len(pool)
    assert pool.names.count("1") == 1


def test_variables_are_inputs_then_modelled_outputs():
    pool = polynomial_pool(CHANNELS, input_lags=(0, 2), output_lags=(1,), degree=1)
    assert pool.variables.rows == ((0, 0), (0, 2), (1, 0), (1, 2), (2, 1), (3, 1))
    assert pool.variable_names == [
        *("speed[t]", "speed[t-2]", "load[t]", "load[t-2]", "NOx[t-1]", "HC[t-1]")
    ]
    assert pool.outputs == (0, 1)


def test_lags_by_channel_leave_the_others_out():
    pool = polynomial_pool(
        CHANNELS,
        outputs=["HC"],
        input_lags={"load": (0, 5)},
        output_lags={"HC": [2]},
        degree=2,
    )
    assert pool.variable_names == ["load[t]", "load[t-5]", "HC[t-2]"]
    assert pool.outputs == (1,)
    assert pool.variables.longest == 5


def test_one_output_may_be_named_by_itself():
    options = {"input_lags": (1,), "output_lags": (1,), "degree": 1}
    alone = polynomial_pool(CHANNELS, outputs="NOx", **options)
    listed = polynomial_pool(CHANNELS, outputs=["NOx"], **options)
    assert alone.outputs == listed.outputs == (0,)
    assert alone.variables == listed.variables


def test_a_pool_without_feedback_or_without_inputs():
    static = polynomial_pool(CHANNELS, input_lags=(0,), output_lags=(), degree=2)
    assert static.variable_names == ["speed[t]", "load[t]"]
    series = polynomial_pool(
        Channels((), CHANNELS.outputs), input_lags=(), output_lags=(1,), degree=2
    )
    assert series.variable_names == ["NOx[t-1]", "HC[t-1]"]


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_terms_evaluate_to_the_products_of_their_names(degree):
    pool = polynomial_pool(
        CHANNELS, outputs=["NOx"], input_lags=(1,), output_lags=(1, 2), degree=degree
    )
    x = np.random.default_rng(degree).normal(size=(9, len(pool.variables)))
    v = np.concatenate([np.ones((1, 9)), x.T])
    found = np.asarray(evaluate(pool.factor, jnp.asarray(v)))
    np.testing.assert_allclose(found, term_matrix(x, pool.factor).T, rtol=1e-15 * 4)
    values = dict(zip(pool.variable_names, x.T, strict=True))
    for row, name in zip(found, pool.names, strict=True):
        expected = np.ones(9)
        for part in name.split("*") if name != "1" else ():
            variable, _, power = part.partition("^")
            expected = expected * values[variable] ** int(power or 1)
        np.testing.assert_allclose(row, expected, rtol=1e-14)


def test_one_sample_equals_its_column_of_many():
    factor = full_pool(3, 3)
    v = jnp.asarray(np.random.default_rng(0).normal(size=(4, 5, 2)))
    many = evaluate(factor, v)
    assert many.shape == (len(factor), 5, 2)
    np.testing.assert_array_equal(evaluate(factor, v[:, 3, 1]), many[:, 3, 1])
    # The table may be traced as well.
    traced = jax.jit(evaluate)(jnp.asarray(factor), v)
    np.testing.assert_allclose(traced, many, rtol=1e-15)


def test_float32_stays_float32():
    assert evaluate(full_pool(2, 3), jnp.ones((3, 4), jnp.float32)).dtype == "float32"


def test_variables_know_their_columns():
    table = Variables(((0, 0), (2, 7), (1, 3)))
    np.testing.assert_array_equal(table.signal, [0, 2, 1])
    np.testing.assert_array_equal(table.lag, [0, 7, 3])
    assert table.longest == 7 and len(table) == 3 and list(table)[1] == (2, 7)
    assert Variables(()).longest == 0


# what is refused ------------------------------------------------------------------

REFUSED = [
    ({"outputs": ["Nox"]}, "outputs", "Did you mean 'NOx'"),
    ({"outputs": ["speed"]}, "outputs", "Known names: NOx, HC"),
    ({"input_lags": {"sped": (0,)}}, "input_lags", "Did you mean 'speed'"),
    ({"input_lags": {"NOx": (1,)}}, "input_lags", "not a modelled input"),
    ({"output_lags": {"HC": (1,)}, "outputs": ["NOx"]}, "output_lags", "'HC'"),
    ({"output_lags": (0, 1)}, "output_lags", "at least 1, got 0"),
    ({"input_lags": (-1,)}, "input_lags", "'speed'.*at least 0, got -1"),
    ({"input_lags": (True,)}, "input_lags", "True.*whole number"),
    ({"input_lags": (1, 2, 1)}, "input_lags", r"'speed' repeat: \[1, 2, 1\]"),
    ({"degree": 0}, "degree", "1 to 4, got 0"),
    ({"degree": 5}, "degree", "1 to 4, got 5"),
    ({"input_lags": (), "output_lags": ()}, "input_lags", "no lagged variables"),
    (
        {"input_lags": tuple(range(60)), "degree": 4},
        "degree",
        r"121 lagged variables at degree 4 make 9,691,375 terms.*fewer lags",
    ),
]


@pytest.mark.parametrize(
    ("change", "field", "message"), REFUSED, ids=lambda x: str(x)[:30]
)
def test_wrong_requests_say_what_and_why(change, field, message):
    options = {
        "outputs": ["NOx"],
        "input_lags": (0,),
        "output_lags": (1,),
        "degree": 2,
    }
    with pytest.raises(SpecError, match=message) as caught:
        polynomial_pool(CHANNELS, **(options | change))
    assert caught.value.field == field


def test_a_number_among_filters_is_the_time_constant_of_a_first_order_lag():
    """As in the settings of an identification; what is neither is told."""
    lags = {"input_lags": (1,), "output_lags": (), "degree": 1}
    numbers, filters = (
        polynomial_pool(CHANNELS, filters=bank, **lags)
        for bank in ([0.5, 2], [LowPass(0.5), LowPass(2.0)])
    )
    assert numbers.variables == filters.variables
    with pytest.raises(SpecError, match="repeat"):
        polynomial_pool(CHANNELS, filters=[2, LowPass(2.0)], **lags)
    with pytest.raises(SpecError, match="filters"):
        wrong: Any = ["slow"]
        polynomial_pool(CHANNELS, filters=wrong, **lags)
