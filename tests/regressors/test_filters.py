"""Filters: against SciPy, orthonormal, at rest where they begin, record and stream."""

import equinox as eqx
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnarx.data import Channel, Channels
from jaxnarx.errors import SpecError
from jaxnarx.regressors import (
    Kautz,
    Laguerre,
    LowPass,
    Orthonormal,
    Variables,
    filter_from_dict,
    filter_to_dict,
    kautz_bank,
    laguerre_bank,
    low_pass_bank,
    orthonormal_bank,
    parse_variable,
    realise,
    require_sampled,
    variable_name,
)
from jaxnarx.regressors.filtering import filter_input, filter_table

T = 0.1
POLES = (-1.0, -0.5 + 2j, -2.5)
BANKS = {
    "laguerre": laguerre_bank(0.7, 6),
    "kautz": kautz_bank(3.0, 0.3, 6),
    "mixed": orthonormal_bank(POLES, 6),
}
# 600 samples at 0.1 s: the slowest pole here decays by exp(-30), below rounding.
LENGTH = 600


_run = eqx.filter_jit(filter_input)


def response(filter_, u) -> np.ndarray:
    # beside a long one, so that all tables have one shape and are compiled once
    table = filter_table((filter_, Laguerre(1.0, 6)))[0]
    return np.asarray(_run(table, jnp.asarray(u), None, jnp.asarray(T)))


def pulse(length=LENGTH) -> np.ndarray:
    """Zero first, so that the filter begins with an empty state."""
    return np.eye(1, length, 1)[0]


def noise(length=200, seed=0) -> np.ndarray:
    return np.random.default_rng(seed).normal(2.0, 1.0, length)


def cascade(poles: tuple[complex, ...], order: int):
    """Numerator and denominator in 1/z of function `order`, complex section by section.

    For real poles the textbook product; for pairs Wahlberg's (1994) eq. 7, times z.
    """
    number, size = np.array([1.0]), np.array([1.0])
    left = order
    while True:
        for p in poles:
            r = np.exp(complex(p) * T)
            if complex(p).imag == 0:
                a = r.real
                if left == 1:
                    return number * np.sqrt(1 - a**2), np.convolve(size, [1, -a])
                number, size = np.convolve(number, [-a, 1]), np.convolve(size, [1, -a])
                left -= 1
                continue
            b, c = 2 * r.real / (1 + abs(r) ** 2), -(abs(r) ** 2)
            below = [1, b * (c - 1), -c]
            if left <= 2:
                top = [1, -b] if left == 1 else [0, np.sqrt(1 - b**2)]
                top = np.sqrt(1 - c**2) * np.array(top)
                return np.convolve(number, top), np.convolve(size, below)
            number = np.convolve(number, below[::-1])
            size, left = np.convolve(size, below), left - 2


# oracles --------------------------------------------------------------------------


@pytest.mark.parametrize("time_constant", [0.01, 0.5, 20.0])
def test_a_low_pass_is_scipys_first_order_lag(time_constant):
    a, u = np.exp(-T / time_constant), noise()
    expected, _ = scipy.signal.lfilter([1 - a], [1, -a], u, zi=[a * u[0]])
    np.testing.assert_allclose(response(LowPass(time_constant), u), expected, 1e-12)


@pytest.mark.parametrize("poles", [(-2.0,), (-0.5 + 2j,), POLES])
@pytest.mark.parametrize("order", [1, 2, 4])
def test_functions_are_the_rational_ones_of_the_literature(poles, order):
    # the coefficients of six near poles lose some digits; the cascade does not
    number, size = cascade(poles, order)
    u = noise()
    zi = scipy.signal.lfilter_zi(number, size) * u[0]
    expected, _ = scipy.signal.lfilter(number, size, u, zi=zi)
    np.testing.assert_allclose(
        response(Orthonormal(poles, order), u), expected, rtol=1e-9, atol=1e-9
    )


def test_the_continuous_poles_become_the_discrete_ones():
    system = realise(Orthonormal(POLES, 4), T)
    found = np.linalg.eigvals(np.asarray(system.a))
    expected = np.exp(np.array([POLES[0], POLES[1], np.conj(POLES[1]), POLES[2]]) * T)
    # the second state of a real pole rests, at zero
    found = found[np.abs(found) > 1e-12]
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(expected), 1e-12)


# mathematics ----------------------------------------------------------------------


@pytest.mark.parametrize("name", BANKS)
def test_impulse_responses_are_orthonormal(name):
    h = np.stack([response(f, pulse())[1:] for f in BANKS[name]])
    np.testing.assert_allclose(h @ h.T, np.eye(len(h)), atol=1e-12)


@pytest.mark.parametrize("filter_", [BANKS[n][-1] for n in BANKS])
def test_states_of_white_noise_are_white(filter_):
    # A A' + b b' = I is the Lyapunov equation of a unit covariance; the second
    # states of real poles have none.
    system = realise(filter_, T)
    a, b = np.asarray(system.a), np.asarray(system.b)
    covariance = a @ a.T + np.outer(b, b)
    used = np.diag(covariance) > 0.5
    np.testing.assert_allclose(covariance, np.diag(used.astype(float)), atol=1e-14)


def test_laguerre_and_kautz_are_cases_of_the_cascade():
    u = noise()
    swing = complex(-3.0 * 0.3, 3.0 * np.sqrt(1 - 0.3**2))
    for order in (1, 3):
        same = [
            (Laguerre(0.7, order), Orthonormal((-1 / 0.7,), order)),
            (Kautz(3.0, 0.3, order), Orthonormal((swing,), order)),
        ]
        for left, right in same:
            np.testing.assert_allclose(response(left, u), response(right, u), 1e-12)


def test_a_low_pass_is_the_first_laguerre_function_with_unit_gain():
    u = noise()
    a = np.exp(-T / 4.0)
    scaled = response(Laguerre(4.0, 1), u) * np.sqrt((1 - a) / (1 + a))
    np.testing.assert_allclose(response(LowPass(4.0), u), scaled, 1e-12)


def test_a_very_short_time_constant_is_no_filter():
    np.testing.assert_allclose(response(LowPass(1e-4), noise()), noise(), 1e-14)


def test_a_slow_filter_keeps_its_static_gain():
    # 1 - a is 1e-6: formed by subtraction it would have ten digits
    assert response(LowPass(1e5), np.full(200, 7.0))[-1] == pytest.approx(7.0, rel=1e-9)


@pytest.mark.parametrize("filter_", [LowPass(1.0), *(b[-1] for b in BANKS.values())])
def test_a_constant_input_finds_the_filter_at_rest(filter_):
    y = response(filter_, np.full(200, 3.0))
    np.testing.assert_allclose(y, y[0], rtol=1e-12)
    settled = response(filter_, np.where(np.arange(LENGTH) > 0, 3.0, 0.0))[-1]
    assert settled == pytest.approx(y[0], rel=1e-9)


@pytest.mark.parametrize("length", [1, 63, 64, 65, 200])
def test_a_stream_gives_what_the_record_gives(length):
    filter_, u = Orthonormal(POLES, 5), noise(length)
    system = realise(filter_, T)
    state, y = system.initial(jnp.asarray(u[0])), []
    for value in u:
        state, now = system.step(state, jnp.asarray(value))
        y.append(float(now))
    np.testing.assert_allclose(response(filter_, u), y, rtol=1e-11, atol=1e-12)


def test_missing_samples_are_bridged_and_the_beginning_is_the_first_valid_value():
    u = noise(90)
    valid = np.ones(90, bool)
    valid[:5] = valid[40:47] = valid[80:] = False
    held = u.copy()
    held[:5], held[40:47], held[80:] = u[5], u[39], u[79]
    table = filter_table((LowPass(0.5),))[0]
    broken = np.where(valid, u, 1e6)
    found = _run(table, jnp.asarray(broken), jnp.asarray(valid), jnp.asarray(T))
    np.testing.assert_allclose(np.asarray(found), response(LowPass(0.5), held), 1e-12)


def test_padding_of_the_table_does_not_matter():
    u = jnp.asarray(noise(90))
    short = _run(filter_table((LowPass(0.5),))[0], u, None, jnp.asarray(T))
    long = response(LowPass(0.5), u)
    np.testing.assert_allclose(np.asarray(short), long, rtol=1e-13)


# settings -------------------------------------------------------------------------


@pytest.mark.parametrize("value", [0, -1.0, np.nan, np.inf, True])
def test_values_out_of_range_are_refused(value):
    with pytest.raises(SpecError, match="time_constant must be a positive"):
        LowPass(value)
    with pytest.raises(SpecError, match="frequency must be a positive"):
        Kautz(value, 0.5, 1)


def test_other_settings_that_make_no_sense_are_refused():
    with pytest.raises(SpecError, match="damping .* below 1, got 1.0"):
        Kautz(1.0, 1.0, 1)
    with pytest.raises(SpecError, match="order must be a whole number from 1 to 30"):
        Laguerre(1.0, 0)
    with pytest.raises(SpecError, match="order must be a whole number from 1 to 30"):
        Laguerre(1.0, 31)
    with pytest.raises(SpecError, match="negative real part"):
        Orthonormal((0.5,), 1)
    with pytest.raises(SpecError, match="positive imaginary part alone"):
        Orthonormal((-1 + 2j, -1 - 2j), 1)
    with pytest.raises(SpecError, match="poles must be 1 to 30 numbers"):
        Orthonormal((), 1)


def test_what_a_sample_time_cannot_show_is_refused():
    require_sampled((None, Kautz(20.0, 0.1, 1)), 0.1)
    with pytest.raises(SpecError, match=r"stay below 31.4159 rad/s"):
        require_sampled((Kautz(40.0, 0.1, 1),), 0.1)
    with pytest.raises(SpecError, match="use a shorter one"):
        realise(LowPass(1e9), 0.1)


def test_banks_are_the_functions_in_order():
    assert low_pass_bank([1, 4]) == (LowPass(1.0), LowPass(4.0))
    assert laguerre_bank(2, 2) == (Laguerre(2.0, 1), Laguerre(2.0, 2))
    assert kautz_bank(2, 0.5, 1) == (Kautz(2.0, 0.5, 1),)
    assert [f.order for f in orthonormal_bank(POLES)] == [1, 2, 3, 4]


def test_modelled_signals_cannot_be_filtered():
    table = Variables.of([(0, 0, LowPass(1.0)), (2, 1, None)])
    table.require_measured((2,), ["u", "w", "y"])
    table = Variables.of([(0, 0, None), (2, 1, LowPass(1.0))])
    with pytest.raises(SpecError, match="y is computed by the model"):
        table.require_measured((2,), ["u", "w", "y"])
    with pytest.raises(SpecError, match="one per variable, got 1 for 2"):
        Variables(((0, 0), (1, 0)), (LowPass(1.0),))


def test_a_table_without_filters_is_the_plain_one():
    assert Variables(((0, 1),), (None,)) == Variables(((0, 1),))


# text and files -------------------------------------------------------------------

ODD = ("speed", "p, rail", "lp(x", "a)[t-1]", "T [°C]", "x, 1 s", "1 2")
numbers = st.floats(1e-300, 1e300)
orders = st.integers(1, 30)
complexes = st.lists(st.tuples(numbers, numbers | st.just(0.0)), min_size=1, max_size=4)


# Plain values are drawn, since checks of types within a strategy use random numbers.
@settings(deadline=None, max_examples=100, derandomize=True)
@given(numbers, numbers, orders, complexes, st.sampled_from(ODD), st.integers(0, 40))
def test_filters_survive_their_text_and_description(x, y, order, poles, name, lag):
    channels = Channels(tuple(map(Channel, ODD)), (Channel("y"),))
    signal = ODD.index(name)
    for filter_ in (
        LowPass(x),
        Laguerre(x, order),
        Kautz(x, min(y, 0.99), order),
        Orthonormal(tuple(complex(-a, b) for a, b in poles), order),
    ):
        text = variable_name(channels, signal, lag, filter_)
        assert parse_variable(channels, text) == (signal, lag, filter_)
        assert filter_from_dict(filter_to_dict(filter_)) == filter_


@pytest.mark.parametrize(
    ("filter_", "text"),
    [
        (LowPass(4), "lp(speed, 4 s)[t]"),
        (Laguerre(0.25, 2), "laguerre(speed, 0.25 s, 2)[t]"),
        (Kautz(2, 0.5, 1), "kautz(speed, 2 rad/s, 0.5, 1)[t]"),
        (Orthonormal((-0.25, -1 + 2j), 3), "basis(speed, -0.25 -1+2j 1/s, 3)[t]"),
    ],
)
def test_filters_read_well(filter_, text):
    channels = Channels((Channel("speed"),), (Channel("y"),))
    assert variable_name(channels, 0, 0, filter_) == text
    loose = text.replace(" s,", ",").replace(" s)", " )").replace(",", " ,")
    assert parse_variable(channels, f" {loose} ") == (0, 0, filter_)


def test_the_exact_name_of_a_channel_wins():
    channels = Channels((Channel("a"), Channel("lp(a, 4 s)")), (Channel("y"),))
    assert parse_variable(channels, "lp(a, 4 s)[t]") == (1, 0, None)
    assert parse_variable(channels, "lp(a, 5 s)[t]") == (0, 0, LowPass(5))


@pytest.mark.parametrize(
    "text", ["lp(speed, four)[t]", "laguerre(speed, 4 s, 1.5)[t]", "kautz(speed,,,)[t]"]
)
def test_numbers_that_are_none_are_refused_with_what_to_write(text):
    with pytest.raises(SpecError, match=r"write 'lp\(name, 4 s\)'"):
        parse_variable(Channels((Channel("speed"),), (Channel("y"),)), text)


def test_unknown_channels_and_forms_are_answered_with_the_nearest():
    channels = Channels((Channel("speed"),), (Channel("y"),))
    with pytest.raises(SpecError, match="unknown channel 'sped'. Did you mean 'speed'"):
        parse_variable(channels, "lp(sped, 4 s)[t]")
    with pytest.raises(SpecError, match="unknown channel 'hp"):
        parse_variable(channels, "hp(speed, 4 s)[t]")
    with pytest.raises(SpecError, match=r"y.*an output cannot be used at lag 0"):
        parse_variable(channels, "lp(y, 4 s)[t]")


@pytest.mark.parametrize(
    "values",
    [
        {"kind": "high_pass", "time_constant": 1.0},
        {"kind": "low_pass"},
        {"kind": "low_pass", "time_constant": 1.0, "order": 2},
        {"kind": "low_pass", "time_constant": "1"},
        {"kind": "laguerre", "time_constant": 1.0, "order": 1e9},
        {"kind": "orthonormal", "poles": [[1.0, 0.0]], "order": 1},
        {},
    ],
)
def test_descriptions_that_are_none_are_refused(values):
    # the types of fields are checked by the tests before the filter sees them
    with pytest.raises((SpecError, jaxtyping.TypeCheckError)):
        filter_from_dict(values)
