"""Variables, terms and equations as text and LaTeX, and the way back."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxnarx.data import Channel, Channels
from jaxnarx.errors import SpecError
from jaxnarx.regressors import equation, parse_variable, term_name, variable_name
from jaxnarx.regressors.text import latex_number, latex_term, latex_variable

CHANNELS = Channels((Channel("speed"), Channel("load")), (Channel("NOx"),))
NAMES = ["speed[t]", "load[t-2]", "NOx[t-1]"]


@pytest.mark.parametrize(
    ("signal", "lag", "text"),
    [(0, 0, "speed[t]"), (1, 12, "load[t-12]"), (2, 1, "NOx[t-1]")],
)
def test_a_variable_and_its_text(signal, lag, text):
    assert variable_name(CHANNELS, signal, lag) == text
    assert parse_variable(CHANNELS, text) == (signal, lag, None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("  speed[t]  ", (0, 0)),
        ("load[ t - 3 ]", (1, 3)),
        ("NOx[t-007]", (2, 7)),
        ("speed[t-0]", (0, 0)),
    ],
)
def test_blanks_and_leading_zeros_do_not_matter(text, expected):
    assert parse_variable(CHANNELS, text) == (*expected, None)


# Whatever may stand in a channel's name: brackets, operators, blanks, other scripts,
# but nothing that is not seen.
names = st.text(min_size=1, max_size=12).filter(
    lambda s: bool(s.strip()) and s.isprintable()
)


# No deadline: the run-time shape check makes the first call slow.
@settings(deadline=None, max_examples=200, derandomize=True)
@given(
    st.lists(names, min_size=2, max_size=4, unique=True),
    st.integers(0, 3),
    st.integers(0, 999_999),
)
def test_every_variable_survives_its_text(chosen, signal, lag):
    channels = Channels(tuple(Channel(n) for n in chosen[:-1]), (Channel(chosen[-1]),))
    signal %= len(chosen)
    lag = max(lag, 1) if signal == len(chosen) - 1 else lag
    text = variable_name(channels, signal, lag)
    assert parse_variable(channels, text) == (signal, lag, None)


@pytest.mark.parametrize(
    "name", ["a[t-1]", "x*y^2", "T [°C]", "p,rail", "__import__('os')", "a b", "[t]"]
)
def test_odd_names_are_only_names(name):
    channels = Channels((Channel("a"), Channel(name)), (Channel("y"),))
    assert parse_variable(channels, variable_name(channels, 1, 3)) == (1, 3, None)
    assert parse_variable(channels, variable_name(channels, 1, 0)) == (1, 0, None)


@pytest.mark.parametrize(
    "text", ["speed", "speed(t-1)", "speed[t+1]", "speed[3]", "[t-1]", "", "speed[t-x]"]
)
def test_other_forms_are_refused_with_the_form_to_write(text):
    with pytest.raises(SpecError, match=r"write 'name\[t\]' or 'name\[t-3\]'"):
        parse_variable(CHANNELS, text)


def test_an_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(SpecError, match="unknown channel 'sped'. Did you mean 'speed'"):
        parse_variable(CHANNELS, "sped[t-1]")
    with pytest.raises(SpecError, match="Known names: speed, load, NOx"):
        parse_variable(CHANNELS, "zzzz[t-1]")


def test_an_output_at_lag_zero_is_refused_with_what_to_write():
    with pytest.raises(SpecError, match=r"NOx\[t-1\]"):
        parse_variable(CHANNELS, "NOx[t]")


# terms ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factors", "text", "latex"),
    [
        ([0, 0, 0], "1", ""),
        ([0, 0, 1], "speed[t]", r"\mathrm{speed}(t)"),
        ([0, 2, 2], "load[t-2]^2", r"\mathrm{load}(t-2)^{2}"),
        ([1, 3, 3], "speed[t]*NOx[t-1]^2", r"\mathrm{speed}(t)\,\mathrm{NOx}(t-1)^{2}"),
        ([3, 3, 3], "NOx[t-1]^3", r"\mathrm{NOx}(t-1)^{3}"),
    ],
)
def test_a_term_in_text_and_latex(factors, text, latex):
    assert term_name(NAMES, factors) == text
    assert latex_term(NAMES, factors) == latex


@pytest.mark.parametrize(
    ("name", "latex"),
    [
        ("N_e[t-1]", r"\mathrm{N\_e}(t-1)"),
        ("egr%[t]", r"\mathrm{egr\%}(t)"),
        ("a{b}$&#[t]", r"\mathrm{a\{b\}\$\&\#}(t)"),
        ("x[1][t-2]", r"\mathrm{x[1]}(t-2)"),
    ],
)
def test_special_characters_are_escaped(name, latex):
    assert latex_variable(name) == latex


@given(names)
@settings(deadline=None, max_examples=100, derandomize=True)
def test_latex_has_balanced_braces_and_no_bare_special_character(name):
    latex = latex_variable(f"{name}[t-1]")
    body = latex.removeprefix(r"\mathrm{").removesuffix("}(t-1)")
    depth, escaped = 0, False
    for character in body:
        if escaped:
            escaped = False
        elif character == "\\":
            escaped = True
        else:
            assert character not in "_%&#$~^"
            depth += {"{": 1, "}": -1}.get(character, 0)
            assert depth >= 0
    assert depth == 0 and not escaped


@given(st.floats(1e-300, 1e300))
@settings(deadline=None, max_examples=100, derandomize=True)
def test_a_latex_number_keeps_six_digits(value):
    mantissa, _, power = latex_number(value).partition(r"\cdot 10^{")
    # Through decimal text: a product of powers of ten could overflow.
    found = float(f"{mantissa}e{power.rstrip('}') or 0}")
    assert math.isclose(found, value, rel_tol=5.1e-6)
    assert "e" not in mantissa


# equations ------------------------------------------------------------------------


def test_an_equation_as_text():
    found = equation("NOx", NAMES, [[0, 3], [1, 2], [0, 0]], [0.93, -0.2, 1e-7])
    assert found == "NOx[t] = 0.93 NOx[t-1] - 0.2 speed[t]*load[t-2] + 1e-07"


def test_an_equation_as_latex():
    found = equation("NO_x", NAMES, [[0, 0], [2, 2]], [-1.5, 2.5e9], style="latex")
    assert found == (
        r"\mathrm{NO\_x}(t) = -1.5 + 2.5\cdot 10^{9}\,\mathrm{load}(t-2)^{2}"
    )


def test_an_equation_without_terms_is_zero():
    assert equation("y", NAMES, [], []) == "y[t] = 0"
    assert equation("y", NAMES, [], [], style="latex") == r"\mathrm{y}(t) = 0"


def test_one_coefficient_for_every_term():
    with pytest.raises(ValueError, match="argument 2 is"):
        equation("y", NAMES, [[0, 1]], [1.0, 2.0])
