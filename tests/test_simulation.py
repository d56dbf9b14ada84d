"""Free runs and k-step predictions against plain loops, and what they refuse.

Networks and data come from `common`; the records differ in length, so every test of
several records is one of padding too.
"""

import dataclasses
from functools import cache, partial

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from common import KINDS, LENGTHS, A, B, W, Y
from jax.flatten_util import ravel_pytree

from jaxnarx.data import Channel, Channels, Dataset
from jaxnarx.data.batch import stack_records
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import Network, run_record
from jaxnarx.partition import grow
from jaxnarx.regressors import polynomial_pool
from jaxnarx.selection import select
from jaxnarx.settings import ForwardOLS, Global
from jaxnarx.simulation import (
    has_diverged,
    make_drive,
    predict,
    simulate,
)
from jaxnarx.sweep.precision import number_type

# Sixty steps of stable recursions, physical values of order ten.
ROUNDING = 1e-10
BOUNDS = {"free": 50.0, "limited": 0.25}


@cache
def data() -> Dataset:
    return common.dataset()


@cache
def simulated(kind: str, bound: float = 50.0):
    return simulate(common.named(kind, bound=bound), data())


# against the plain loops ----------------------------------------------------------


def assert_run(solution, n: int, plain: oracles.Run):
    """Outputs, scored and limited samples of record n."""
    value = solution.value
    np.testing.assert_allclose(value[n], plain.outputs, rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(value.limited[n], plain.limited)
    outputs = plain.outputs.shape[1]
    np.testing.assert_array_equal(
        value.scored[n], np.tile(plain.usable[:, None], (1, outputs))
    )


@pytest.mark.parametrize("bound", BOUNDS.values(), ids=BOUNDS)
@pytest.mark.parametrize("kind", KINDS)
def test_simulate_is_the_plain_free_run(kind, bound):
    net = common.named(kind, bound=bound)
    solution = simulated(kind, bound)
    limited = 0
    for n in range(len(data())):
        plain = oracles.free_run(common.rows_of(data(), n), common.to_oracle(net))
        assert_run(solution, n, plain)
        limited += plain.limited.sum()
    assert (limited > 0) == (bound < 1)


@pytest.mark.parametrize("bound", BOUNDS.values(), ids=BOUNDS)
@pytest.mark.parametrize("k", [1, 3, 10])
@pytest.mark.parametrize("kind", KINDS)
def test_predict_is_the_plain_loop_restarted_for_every_sample(kind, k, bound):
    net = common.named(kind, bound=bound)
    solution = predict(net, data(), k)
    # The first and the shorter second record; the loop is slow.
    for n in (0, 1):
        plain = oracles.k_step(common.rows_of(data(), n), common.to_oracle(net), k)
        assert_run(solution, n, plain)


def test_outputs_before_the_first_prediction_are_the_measured_ones():
    history = common.named("coupled").history
    for n, record in enumerate(data()):
        for found, first in (
            (simulated("coupled").value[n], history),
            (predict(common.named("coupled"), data(), 10).value[n], history + 9),
        ):
            np.testing.assert_array_equal(found[:first], record.y[:first])


def test_simulated_samples_use_no_measured_output():
    net = common.named("coupled, by own output")
    rows = [common.rows_of(data(), n) for n in range(len(data()))]
    for r in rows:
        r[net.history :, Y:] = 1e3
    spoilt = simulate(net, common.from_rows(rows)).value
    for n in range(len(data())):
        after = slice(net.history, None)
        np.testing.assert_array_equal(
            spoilt[n][after], simulated("coupled, by own output").value[n][after]
        )


def test_each_record_is_as_if_it_were_alone():
    kind = "coupled, by own output"
    net = common.named(kind)
    ahead = predict(net, data(), 3)
    n, alone = 1, data()[1]
    for together, single in (
        (simulated(kind).value, simulate(net, alone).value),
        (ahead.value, predict(net, alone, 3).value),
    ):
        np.testing.assert_allclose(together[n], single[0], rtol=0, atol=ROUNDING)
        np.testing.assert_array_equal(together.scored[n], single.scored[0])
    assert simulated(kind).value.names[n] == alone.names[0]


def test_a_free_run_is_the_prediction_from_its_own_start():
    net = common.named("by inputs")
    free = simulated("by inputs").value[0]
    for k in (1, 4, 20):
        sample = net.history + k - 1
        ahead = predict(net, data(), k).value[0]
        np.testing.assert_allclose(ahead[sample], free[sample], atol=ROUNDING)


@pytest.mark.parametrize("k", [43, 45, 60, 61, 62, 200])
def test_a_horizon_longer_than_a_record_scores_nothing_there(k):
    net = common.named("one model")
    value = predict(net, data(), k).value
    for n, length in enumerate(LENGTHS):
        assert value.scored[n].sum() == max(length - net.history - k + 1, 0)
        assert np.all(np.isfinite(value[n]))


@pytest.mark.parametrize(("k", "rows"), [(10, 5), (2, 3), (43, 44)])
def test_a_record_shorter_than_the_horizon_is_too_short(k, rows):
    net = common.named("one model")
    solution = predict(net, common.from_rows([common.rows_of(data(), 0)[:rows]]), k)
    assert solution.status_name == "too_short" and not solution.is_okay
    assert f"{k} steps before the end of its {rows}" in solution.detail
    assert not solution.value.scored[0].any()
    enough = common.from_rows([common.rows_of(data(), 0)[: net.history + k]])
    assert predict(net, enough, k).status_name == "ok"


def test_right_predictions_outside_the_trained_range_are_no_divergence():
    # y doubles the input, which leaves the range that the bound was made of
    part = common.Part([[((1,), 2.0)]])
    net = common.network([part], variables=((A, 1), (Y, 1)), bound=1.0)
    rows = common.rows_of(data(), 0)
    rows[:, A] = 30.0 + np.arange(len(rows)) % 7
    rows[1:, Y] = 2.0 * common.GAIN[Y] / common.GAIN[A] * rows[:-1, A]
    solution = predict(net, common.from_rows([rows]))
    assert solution.status_name == "ok"
    assert not solution.value.limited[0].any()
    assert solution.value.extrapolated[0][1:].all()
    np.testing.assert_allclose(solution.value[0][1:], rows[1:, Y:][:, :1], rtol=1e-12)
    # what is fed back is bounded as in a free run, and said to be
    assert predict(net, common.from_rows([rows]), 2).value.limited[0][2:].all()


def test_a_measured_output_outside_its_range_is_extrapolated_from():
    net = common.named("one model")
    rows = common.rows_of(data(), 0)
    rows[20, Y] = 1e3  # seen at lags 1 and 2
    for k in (1, 3):
        found = predict(net, common.from_rows([rows]), k).value.extrapolated[0]
        lags = [d for s, d in net.variables if s == Y]
        assert found[[19 + k + d for d in lags]].all() and not found[:20].any()


def test_a_horizon_must_be_positive():
    with pytest.raises(SpecError, match="at least 1, got 0"):
        predict(common.named("one model"), data(), 0)


# diverged -------------------------------------------------------------------------


def unstable(growth: float = 1.5) -> Network:
    """y(t) = growth y(t-1) + a(t-1), held within +-3 gains."""
    part = common.Part([[((1,), 1.0), ((2,), growth)]])
    return common.network([part], variables=((A, 1), (Y, 1)), bound=3.0)


def test_an_unstable_run_is_held_and_reported():
    net = unstable()
    solution = simulate(net, data())
    assert solution.status_name == "diverged"
    assert not solution.is_okay
    plain = [
        oracles.free_run(common.rows_of(data(), n), common.to_oracle(net))
        for n in range(len(data()))
    ]
    for n, run in enumerate(plain):
        np.testing.assert_array_equal(solution.value.limited[n], run.limited)
        assert np.all(np.abs(solution.value[n]) <= 30.0)
        np.testing.assert_array_equal(
            solution.value[n][run.limited],
            30.0 * np.sign(solution.value[n][run.limited]),
        )
    # Record 0 diverges for good; its first limited sample is the one reported.
    first = int(np.argmax(plain[0].limited[:, 0]))
    assert plain[0].limited[:, 0].mean() > 0.05
    assert solution.first_bad_step == solution.row == first
    assert solution.time == pytest.approx(0.1 * first)
    assert solution.channel == "y"
    assert solution.stats["record"] == 0
    assert f"record 'record 1' first at sample {first} (t = {0.1 * first:g} s)" in (
        solution.detail
    )


def test_the_row_is_that_of_the_source():
    rows = common.rows_of(data(), 0)
    rows[20, Y] = np.nan
    split = common.from_rows([rows], missing="split")
    assert split.records[1].start_row == 21
    solution = simulate(unstable(), split[1])
    first = solution.first_bad_step
    assert first is not None and solution.row == 21 + first


def test_only_the_record_that_diverges_is_marked():
    rows = [common.rows_of(data(), n) for n in (0, 1)]
    # Nothing ever leaves zero in the second record.
    rows[1][:, [A, Y]] = 0.0
    solution = simulate(unstable(), common.from_rows(rows))
    np.testing.assert_array_equal(
        [d.any() for d in solution.value.diverged], [True, False]
    )
    assert solution.stats["record_status"][0] != solution.stats["record_status"][1] == 0


@pytest.mark.parametrize(
    ("flags", "diverged"),
    [
        ([False] * 100, False),
        ([True] * 5 + [False] * 95, False),
        ([True] * 6 + [False] * 94, True),
        ([False, True] * 50, True),
        ([False] * 1000 + [True] * 49, False),
        ([False] * 1000 + [True] * 50, True),
        ([True] * 25 + [False] * 1000 + [True] * 25, False),
        ([], False),
    ],
)
def test_more_than_five_percent_or_fifty_in_a_row(flags, diverged):
    assert bool(has_diverged(np.array(flags, bool))) is diverged


def test_records_and_outputs_are_judged_side_by_side():
    rng = np.random.default_rng(0)
    held = rng.uniform(size=(3, 2, 300)) < 0.05
    held[0, 0, 100:150] = True
    counted = np.broadcast_to(np.arange(300) >= 120, held.shape)
    every, later = has_diverged(held), has_diverged(held, counted)
    program = jax.jit(has_diverged)(held, counted)
    np.testing.assert_array_equal(later, program)
    for n, o in np.ndindex(3, 2):
        assert every[n, o] == has_diverged(held[n, o])
        assert later[n, o] == has_diverged(held[n, o, 120:])
    assert every.any() and not every.all()


def test_inputs_outside_the_training_range_are_marked():
    net = common.named("by inputs")
    rows = common.rows_of(data(), 0)
    rows[10, A], rows[30, B] = 25.0, -6.0
    value = simulate(net, common.from_rows([rows])).value
    # a is used at lag 0; b at lags 1 and 2.
    np.testing.assert_array_equal(np.flatnonzero(value.extrapolated[0]), [10, 31, 32])
    assert not simulated("by inputs").value.extrapolated[0].any()


# beyond all numbers ---------------------------------------------------------------


@pytest.mark.parametrize("kind", ["one model", "by inputs", "coupled, by own output"])
@pytest.mark.parametrize("part", ["coefficient", "gain", "offset", "span"])
def test_absurd_parameters_give_finite_outputs_that_are_flagged(kind, part):
    def absurd(n):
        return {
            "coefficient": n.models[0].local.coefficient,
            "gain": n.gain,
            "offset": n.models[0].offset,
            "span": n.models[0].span,
        }[part]

    if kind == "one model" and part in ("offset", "span"):
        pytest.skip("no scheduling")
    value = {"coefficient": 1e308, "gain": 5e-324, "offset": 1e200, "span": 5e-324}
    net = eqx.tree_at(
        absurd, common.named(kind), replace_fn=lambda x: jnp.full_like(x, value[part])
    )
    for verb in (simulate, predict, partial(predict, k=3)):
        solution = verb(net, data())
        assert all(np.all(np.isfinite(y)) for y in solution.value.outputs)
        assert solution.status_name == "diverged"


# masked samples -------------------------------------------------------------------


def masked(n: int = 0) -> np.ndarray:
    """A gap in every channel, and the outputs unknown from sample 50 on."""
    rows = common.rows_of(data(), n)
    rows[20:23, A], rows[30, B] = np.nan, np.nan
    rows[10:14, Y], rows[40, W] = np.nan, np.nan
    rows[50:, Y:] = np.nan
    return rows


def test_masked_samples_are_simulated_with_held_inputs_and_not_scored():
    net = common.named("coupled")
    gaps = common.from_rows([masked()])
    solution = simulate(net, gaps)
    plain = oracles.free_run(common.rows_of(gaps, 0), common.to_oracle(net))
    np.testing.assert_allclose(solution.value[0], plain.outputs, atol=ROUNDING)
    valid = gaps.records[0].valid
    tables = {*net.variables, *net.models[0].scheduling, *net.models[1].scheduling}
    for t in range(60):
        inputs = all(t >= lag and valid[t - lag, s] for s, lag in tables if s in (A, B))
        expected = valid[t, Y:] & inputs & (t >= net.history)
        np.testing.assert_array_equal(solution.value.scored[0][t], expected)


def test_a_run_starts_at_the_first_complete_history():
    net = common.named("coupled")
    rows = common.rows_of(data(), 0)
    rows[4, W] = np.nan
    rows[1, Y] = np.nan
    late = common.from_rows([rows])
    # y at sample 1 is seen until 3; w at sample 4 is not seen by sample 4 itself.
    # Samples 2 and 3 have all their inputs and a measured output, but no start.
    solution = simulate(net, late)
    tail = oracles.free_run(rows[2:], common.to_oracle(net))
    np.testing.assert_allclose(solution.value[0][4:], tail.outputs[2:], atol=ROUNDING)
    np.testing.assert_array_equal(
        solution.value.scored[0][:5].any(axis=1), [0, 0, 0, 0, 1]
    )


@pytest.mark.parametrize("k", [1, 3])
def test_predictions_from_an_incomplete_history_are_not_scored(k):
    net = common.named("coupled")
    gaps = common.from_rows([masked()])
    solution = predict(net, gaps, k)
    rows, valid = common.rows_of(gaps, 0), gaps.records[0].valid
    plain = oracles.k_step(rows, common.to_oracle(net), k)
    np.testing.assert_allclose(
        solution.value[0][plain.usable], plain.outputs[plain.usable], atol=ROUNDING
    )
    tables = {*net.variables, *net.models[0].scheduling, *net.models[1].scheduling}

    def complete(t, signals):
        return t >= net.history and all(
            valid[t - lag, s] for s, lag in tables if s in signals
        )

    for t in range(60):
        ready = complete(t - k + 1, range(4)) and complete(t, (A, B))
        np.testing.assert_array_equal(solution.value.scored[0][t], ready & valid[t, Y:])


# channels and refusals ------------------------------------------------------------


def arranged(inputs, outputs, columns, **options) -> Dataset:
    rows = common.rows_of(data(), 0)
    split = len(inputs)
    return Dataset.from_arrays(
        rows[:, columns[:split]],
        rows[:, columns[split:]],
        inputs=inputs,
        outputs=outputs,
        sample_time=options.pop("sample_time", 0.1),
        **options,
    )


@pytest.mark.parametrize(
    ("inputs", "outputs", "columns"),
    [
        (["b", "a"], ["w", "y"], [B, A, W, Y]),
        (["y", "b"], ["a", "w"], [Y, B, A, W]),
        (["extra", "b", "a"], ["y", "more", "w"], [Y, B, A, Y, A, W]),
    ],
    ids=["other order", "outputs as inputs", "extra"],
)
def test_channels_are_matched_by_name(inputs, outputs, columns):
    found = simulate(common.named("coupled"), arranged(inputs, outputs, columns))
    np.testing.assert_array_equal(
        found.value[0], simulate(common.named("coupled"), data()[0]).value[0]
    )


def test_channels_that_the_model_does_not_know_are_said():
    net = common.named("one model")
    known = data().channels
    more = Channels((*known.inputs, Channel("spare")), known.outputs)
    records = [
        dataclasses.replace(
            r,
            u=np.c_[r.u, r.u[:, :1]],
            valid=np.c_[r.valid[:, :2], r.valid[:, :1], r.valid[:, 2:]],
        )
        for r in data()
    ]
    wide = Dataset(tuple(records), more, data().sample_time)
    for verb in (simulate, predict):
        solution = verb(net, wide)
        assert solution.status_name == "ok"
        assert solution.stats["ignored"] == ("spare",)
        assert solution.detail.endswith("are ignored: spare")
        assert "ignored" not in verb(net, data()).stats
        np.testing.assert_array_equal(solution.value[0], verb(net, data()).value[0])


def test_a_missing_channel_is_named_with_the_nearest():
    wrong = arranged(["aa", "b"], ["y", "w"], [A, B, Y, W])
    with pytest.raises(SpecError, match="no channel 'a'.*Did you mean 'aa'"):
        simulate(common.named("one model"), wrong)


def test_another_unit_is_refused():
    wrong = arranged([Channel("a", "mA"), "b"], ["y", "w"], [A, B, Y, W])
    with pytest.raises(SpecError, match="a is in 'mA' in the data.*'V'"):
        simulate(common.named("one model"), wrong)


@pytest.mark.parametrize("verb", [simulate, predict])
def test_another_sample_time_is_refused(verb):
    wrong = arranged(["a", "b"], ["y", "w"], [A, B, Y, W], sample_time=0.2)
    with pytest.raises(SpecError, match=r"0\.1 s, the data have 0\.2 s; resample"):
        verb(common.named("one model"), wrong)


@pytest.mark.parametrize("length", [1, 2, 5, 6, 7])
@pytest.mark.parametrize("verb", [simulate, predict])
def test_no_record_long_enough_is_an_error(verb, length):
    far = common.network([common.Part([[((1,), 0.5)]])], variables=((A, 7), (Y, 1)))
    short = common.from_rows([common.rows_of(data(), 0)[:length]])
    with pytest.raises(
        DataError, match=rf"needs 7 valid.*'record 1' has {length} rows"
    ):
        verb(far, short)


def test_one_record_that_is_too_short_is_a_status():
    far = common.network([common.Part([[((1,), 0.5)]])], variables=((A, 3), (Y, 1)))
    solution = simulate(far, data())
    assert solution.status_name == "too_short"
    assert "'record 3' has no 3 valid samples in a row" in solution.detail
    status = solution.stats["record_status"]
    assert status[2] != 0 and not np.any(status[[0, 1, 3]])
    assert not solution.value.scored[2].any()
    np.testing.assert_array_equal(solution.value[2], data().records[2].y[:, :1])


def test_float64_data_without_x64_say_how_to_switch_it_on():
    rng = np.random.default_rng(0)

    def make(dtype):
        u = rng.normal(size=50).astype(dtype)
        y = np.convolve(u, np.ones(3, dtype))[:50]
        return Dataset.from_arrays(u, y, inputs=["u"], outputs=["y"], sample_time=1.0)

    one, double = make(np.float32), make(np.float64)
    pool = polynomial_pool(one.channels, input_lags=(0, 1), output_lags=(1,), degree=1)
    with number_type(float64=False):
        terms = select(pool, one, ForwardOLS(max_terms=3)).value
        net = grow(terms, one, Global()).value
        assert simulate(net, one).value[0].dtype == np.float32
        for verb in (
            lambda: select(pool, double),
            lambda: grow(pool, double, Global()),
            lambda: simulate(net, double),
        ):
            with pytest.raises(
                SpecError, match=r"jax\.config\.update\('jax_enable_x64', True\)"
            ):
                verb()


def test_float32_stays_float32():
    rows = [common.rows_of(data(), 0).astype(np.float32)]
    net = jax.tree.map(
        lambda a: a.astype(jnp.float32) if eqx.is_inexact_array(a) else a,
        common.named("coupled"),
    )
    found = simulate(net, common.from_rows(rows)).value[0]
    assert found.dtype == np.float32
    # Stable recursions on values of order ten in single precision.
    np.testing.assert_allclose(found, simulated("coupled").value[0], rtol=0, atol=1e-3)


# gradients ------------------------------------------------------------------------


@eqx.filter_jit
def loss(moving, fixed, args, anchor):
    v, x, measured = args
    y = run_record(eqx.combine(moving, fixed), v, x, measured, anchor)
    begun = jnp.cumsum(anchor)[:, None] > 0
    return jnp.sum(jnp.where(begun, y - measured, 0.0) ** 2)


gradient = eqx.filter_jit(eqx.filter_grad(loss))


@pytest.mark.parametrize("kind", ["by inputs", "coupled, by own output"])
@pytest.mark.parametrize("bound", BOUNDS.values(), ids=BOUNDS)
def test_gradient_of_a_run_is_the_central_difference(kind, bound):
    net = common.named(kind, bound=bound)
    d = make_drive(net, stack_records(data()))
    args = d.v[0], tuple(x[0] for x in d.x), d.measured[0]
    # Two starts: the gradient must respect them.
    anchor = jnp.isin(jnp.arange(common.TIME), jnp.array([net.history, 25]))
    trained = eqx.tree_at(
        lambda n: [
            leaf
            for m in n.models
            for leaf in (m.local.coefficient, m.validity.centre, m.validity.log_width)
        ],
        jax.tree.map(lambda _: False, net),
        replace_fn=lambda _: True,
    )
    moving, fixed = eqx.partition(net, trained)
    flat, unravel = ravel_pytree(moving)
    found, _ = ravel_pytree(gradient(moving, fixed, args, anchor))
    expected = oracles.central_difference(
        lambda p: np.asarray(loss(unravel(jnp.asarray(p)), fixed, args, anchor)),
        np.asarray(flat),
        eps=1e-6,
    )
    # Sums near 10: rounding 1e-15 / 1e-6, and h^2 times a third derivative near 1e3.
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7)
    assert np.sum(np.abs(expected) > 1e-3) > 0.6 * len(expected)


def test_series_without_inputs_run_too():
    channels = Channels((), (Channel("y"),))
    series = Dataset.from_arrays(
        None, [1.0, 2.0, 3.0, 2.0, 1.0, 0.0], inputs=[], outputs=["y"], sample_time=0.1
    )
    assert series.channels == channels
    plain = common.network(
        [common.Part([[((1,), 0.5), ((0,), 0.1)]])], variables=((0, 1),)
    )
    net = Network(
        channels,
        (0,),
        plain.variables,
        plain.models,
        jnp.asarray([2.0]),
        plain.lower,
        plain.upper,
        jnp.asarray([-9.0]),
        jnp.asarray([9.0]),
        plain.sample_time,
    )
    expected = [1.0]
    for _ in range(5):
        expected.append(0.5 * expected[-1] + 0.2)
    np.testing.assert_allclose(
        simulate(net, series).value[0][:, 0], expected, rtol=1e-14
    )
