"""What requests are held to: values pass as they are, others name field and value."""

import numpy as np
import pytest

from jaxnarx.checks import (
    choice,
    finite,
    not_negative,
    positive,
    require,
    require_known,
    span,
    whole,
)
from jaxnarx.errors import SpecError


@pytest.mark.parametrize(
    "passed, value",
    [
        (whole(np.int64(3), "n"), 3),
        (whole(0, "n", 0), 0),
        (whole(4, "n", most=4), 4),
        (finite(-2, "x"), -2.0),
        (positive(np.float32(0.5), "x"), 0.5),
        (not_negative(0, "x"), 0.0),
        (span((1, 1), "x"), (1.0, 1.0)),
        (choice("b", ("a", "b"), "x"), "b"),
        (require_known("b", ["a", "b"], "x"), "b"),
    ],
)
def test_what_fits_comes_back(passed, value):
    assert passed == value and type(passed) is type(value)


@pytest.mark.parametrize(
    "check, message",
    [
        (lambda: whole(0, "n"), "n must be at least 1, got 0"),
        (lambda: whole(1.0, "n"), "n must be a whole number, got 1.0"),
        (lambda: whole(True, "n"), "n must be a whole number, got True"),
        (lambda: whole(5, "n", most=4), "n must be a whole number from 1 to 4, got 5"),
        (lambda: finite(np.nan, "n"), "n must be a finite number, got nan"),
        (lambda: positive(0, "n"), "n must be a positive finite number, got 0"),
        (lambda: positive("1", "n"), "n must be a positive finite number, got '1'"),
        (lambda: positive(1, "n", below=1), "number below 1, got 1"),
        (lambda: positive(np.inf, "n", "angle"), "n must be a positive angle, got inf"),
        (lambda: not_negative(-1, "n"), "n must be finite and must not be negative"),
        (lambda: span((2, 1), "n"), "n must be (low, high)"),
        (lambda: choice("c", ("a", "b"), "n"), "n must be one of 'a', 'b', got 'c'"),
        (lambda: choice("foward", ("forward", "b"), "n"), "Did you mean 'forward'?"),
        (
            lambda: require_known("sped", ["speed"], "n"),
            "unknown n 'sped'. Did you mean",
        ),
        (lambda: require_known("x", ["a"], "n", "no x"), "no x. Known names: a."),
        (lambda: require(False, "n", "so"), "so"),
    ],
)
def test_what_does_not_fit_names_field_and_value(check, message):
    with pytest.raises(SpecError) as caught:
        check()
    assert caught.value.field == "n" and message in str(caught.value)
