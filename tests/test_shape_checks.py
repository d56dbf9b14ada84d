"""The checks that all other tests rely on find what is wrong, wherever it stands."""

import dataclasses

import numpy as np
import pytest
import shape_checks
from jaxtyping import Float, TypeCheckError

from jaxnarx.arrays.windows import usable
from jaxnarx.shell.parse_ranges import parse_seconds

Row = Float[np.ndarray, " n"]
checked = shape_checks.checked(typechecker=shape_checks.plain)
TWO, THREE = np.zeros(2), np.zeros(3)


@checked
def product(a: Row, b: Row) -> Float[np.ndarray, " n"]:
    return a if b[0] == 0 else np.zeros(5)


@checked
def within(a: Row, rows: list[Float[np.ndarray, " m"]]) -> int:
    """Every call has axes of its own: those of the inner call may differ."""
    return len(product(rows[0], rows[0])) + len(a)


@checked
def named(text: str, count: int = 1) -> str:
    return text * count if count else None  # pyright: ignore[reportReturnType]


@checked
@dataclasses.dataclass
class Holder:
    row: Row
    other: Row


@pytest.mark.parametrize(
    "call",
    [
        lambda: product(TWO, THREE),
        lambda: product(TWO, np.ones(2)),
        lambda: product(np.zeros((2, 2)), TWO),
        lambda: product(TWO.astype(int), TWO),
        lambda: product([0.0, 0.0], TWO),
        lambda: within(TWO, [np.zeros((1, 1))]),
        lambda: named(3),
        lambda: named("a", count="b"),
        lambda: named("a", 0),
        lambda: Holder(TWO, THREE),
    ],
    ids=["two sizes", "returned", "axes", "dtype", "list", "in a list", "no text"]
    + ["keyword", "returned None", "dataclass"],
)
def test_what_is_wrong_is_refused(call):
    with pytest.raises(TypeCheckError):
        call()


def test_many_calls_are_checked_at_first_and_in_the_next_test_again():
    for _ in range(shape_checks.FIRST):
        named("a")
    with pytest.raises(TypeError):  # Python's own: "a" * "b"
        named("a", count="b")  # pyright: ignore[reportArgumentType]
    shape_checks.next_test()
    with pytest.raises(TypeCheckError):
        named("a", count="b")  # pyright: ignore[reportArgumentType]


def test_what_is_right_passes():
    assert product(TWO, TWO) is TWO
    assert within(TWO, [THREE]) == 5
    assert named("a", count=2) == "aa"
    assert Holder(TWO, np.ones(2)).row is TWO


def test_the_package_is_checked():
    valid = np.ones((2, 4, 1), bool)
    assert usable(valid, ((0, 1),), 1).sum() == 6
    with pytest.raises(TypeCheckError):
        usable(valid[0], ((0, 1),), 1)  # pyright: ignore[reportArgumentType]
    with pytest.raises(TypeCheckError):
        parse_seconds(600, "--budget")  # pyright: ignore[reportArgumentType]


def test_what_has_no_annotation_is_not_touched():
    def bare(a, b):
        return a

    assert checked(bare) is bare
