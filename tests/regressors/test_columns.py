"""Columns of lagged and filtered variables: record by record, whatever lies between."""

import common
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
import scipy.signal
from common import TIME, A, B, W, Y

from jaxnarx.data import Channel, Channels
from jaxnarx.data.batch import stack_records
from jaxnarx.data.scaling import gains
from jaxnarx.errors import SpecError
from jaxnarx.regressors import (
    Kautz,
    Laguerre,
    LowPass,
    Variables,
    polynomial_pool,
    record_columns,
    row_columns,
)
from jaxnarx.regressors.rows import regression_rows

SLOW, QUICK = LowPass(2.0), LowPass(0.3)
TABLE = Variables.of(
    [
        (A, 0, None),
        (A, 0, SLOW),
        (B, 1, QUICK),
        (Y, 2, None),
        (A, 3, SLOW),
        (W, 1, Laguerre(0.5, 2)),
        (B, 1, None),
    ]
)


@pytest.fixture(scope="module")
def data():
    """Three records of unequal length; b of the second misses some samples."""
    rows = [common.signals(n) for n in (60, 45, 52)]
    rows[1][20:24, B] = np.nan
    rows[1][:3, B] = np.nan
    return common.from_rows(rows)


def low_pass(u: np.ndarray, time_constant: float) -> np.ndarray:
    """First-order lag at rest at the first sample, as SciPy has it."""
    a = np.exp(-0.1 / time_constant)
    return scipy.signal.lfilter([1 - a], [1, -a], u, zi=[a * u[0]])[0]


def expected(record) -> np.ndarray:
    """The first five variables of `TABLE`; nan before the first sample."""
    u, y = record.u, record.y
    slow, quick = low_pass(u[:, 0], 2.0), low_pass(u[:, 1], 0.3)

    def late(x, lag):
        return np.concatenate([np.full(lag, np.nan), x[: len(x) - lag]])

    parts = (u[:, 0], slow, late(quick, 1), late(y[:, 0], 2), late(slow, 3))
    return np.stack(parts)


@pytest.fixture(scope="module")
def rows(data):
    return regression_rows(data, TABLE, (0,), history=3)


def test_rows_are_the_filtered_signals_of_their_record(data, rows):
    # Missing values of a `Record` are held at the last valid one, the next at the
    # beginning: what the filters do as well.
    wanted = np.full((5, 3, TIME), np.nan)
    for n, record in enumerate(data):
        wanted[:, n, : len(record)] = expected(record)
    wanted = wanted.reshape(5, -1)[:, rows.at]
    gain = gains(data)[TABLE.signal[:5]]
    np.testing.assert_allclose(rows.v[1:6] * gain[:, None], wanted, rtol=1e-11)
    np.testing.assert_array_equal(rows.v[0], 1.0)


def test_a_filtered_variable_is_usable_where_its_signal_is(data, rows):
    plain = Variables(TABLE.rows)
    np.testing.assert_array_equal(
        rows.at, regression_rows(data, plain, (0,), history=3).at
    )


def test_plain_columns_are_untouched_by_filters_beside_them(data, rows):
    plain = regression_rows(data, Variables(TABLE.rows), (0,), history=3)
    unfiltered = [n for n, (*_, f) in enumerate(TABLE.entries) if f is None]
    for n in unfiltered:
        np.testing.assert_array_equal(rows.v[n + 1], plain.v[n + 1])
    np.testing.assert_array_equal(rows.y, plain.y)


def test_unfiltered_rows_are_the_oracles(data):
    variables = Variables(((A, 0), (B, 2), (Y, 1)))
    found = regression_rows(data, variables, (0, 1), history=2)
    wanted, start = [], 0
    for n, record in enumerate(data):
        x, _ = oracles.lagged(common.rows_of(data, n) / gains(data), variables.rows)
        at = found.at[(found.at >= start) & (found.at < start + TIME)] - start
        wanted.append(x[at])
        start += TIME
        assert at.max() < len(record)
    np.testing.assert_array_equal(found.v[1:], np.concatenate(wanted).T)


@pytest.fixture(scope="module")
def columns():
    """`record_columns` of `TABLE` at every sample, compiled."""

    @jax.jit
    def run(signals, valid):
        at = jnp.arange(signals.shape[0])
        return record_columns(signals, valid, at, TABLE, jnp.asarray(0.1))

    return run


def test_one_record_in_a_trace_is_the_same_as_rows(data, columns):
    batch = stack_records(data)
    for n in range(3):
        at = np.flatnonzero(batch.valid[n].all(axis=1))[3:]
        one = np.asarray(columns(batch.signals[n], batch.valid[n]))[:, at]
        many = row_columns(batch, at + TIME * n, TABLE, 0.1)
        np.testing.assert_allclose(one, many, rtol=1e-12, atol=1e-14)


def test_the_columns_are_linear_and_do_not_depend_on_what_is_missing(data, columns):
    batch = stack_records(data)
    signals, valid = batch.signals[1], batch.valid[1]
    base = columns(signals, valid)
    np.testing.assert_allclose(columns(3 * signals, valid), 3 * base, atol=1e-12)
    filtered = [n for n, (*_, f) in enumerate(TABLE.entries) if f is not None]
    other = columns(jnp.where(valid, signals, 1e9), valid)
    np.testing.assert_array_equal(other[np.array(filtered)], base[np.array(filtered)])


def test_the_order_of_records_does_not_matter(data, rows):
    turned = regression_rows(data[[2, 0, 1]], TABLE, (0,), history=3)
    # records 0, 1, 2 are now the second, the third and the first
    place = TIME * np.array([1, 2, 0])[rows.at // TIME] + rows.at % TIME
    at = np.searchsorted(turned.at, place)
    np.testing.assert_array_equal(turned.at[at], place)
    np.testing.assert_allclose(np.asarray(turned.v)[:, at], rows.v, rtol=1e-12)


def test_a_filter_too_quick_for_the_data_is_refused(data):
    table = Variables.of([(A, 0, Kautz(40.0, 0.2, 1))])
    with pytest.raises(SpecError, match="a sample time of 0.1 s cannot show"):
        regression_rows(data, table, (0,), history=0)


# pools ----------------------------------------------------------------------------

CHANNELS = Channels((Channel("a"), Channel("b")), (Channel("y"),))


def pool(**options):
    return polynomial_pool(
        CHANNELS, **{"input_lags": (), "output_lags": (), "degree": 1} | options
    )


def test_filters_of_a_pool_stand_between_inputs_and_outputs():
    found = pool(input_lags=(1,), output_lags=(1,), filters=(QUICK, SLOW))
    assert found.variable_names == [
        "a[t-1]",
        "b[t-1]",
        "lp(a, 0.3 s)[t]",
        "lp(a, 2 s)[t]",
        "lp(b, 0.3 s)[t]",
        "lp(b, 2 s)[t]",
        "y[t-1]",
    ]
    assert (
        "lp(a, 2 s)[t]*y[t-1]"
        in pool(output_lags=(1,), filters=(SLOW,), degree=2).names
    )


def test_filters_by_channel_and_at_other_lags():
    found = pool(filters={"b": (SLOW,)}, filter_lags=(0, 3))
    assert found.variable_names == ["lp(b, 2 s)[t]", "lp(b, 2 s)[t-3]"]
    assert found.variables.longest == 3
    assert pool(input_lags=(1,), filters=()).variables.filters == ()


def test_filters_that_make_no_sense_are_refused():
    with pytest.raises(SpecError, match="filters names 'y', which is not an input"):
        pool(filters={"y": (SLOW,)})
    with pytest.raises(SpecError, match="filters of 'a' repeat"):
        pool(filters=(SLOW, LowPass(2)))
    with pytest.raises(SpecError, match="filter_lags .* of at least 0, got -1"):
        pool(filters=(SLOW,), filter_lags=(-1,))
    with pytest.raises(SpecError, match="give input_lags, output_lags or filters"):
        pool()
