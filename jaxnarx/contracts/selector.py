"""The contract of a selector, `SELECTORS.register(name, selector)`."""

from pathlib import Path

import numpy as np

from jaxnarx.contracts.life import lives, plant, pool
from jaxnarx.partition import grow
from jaxnarx.selection import select
from jaxnarx.settings import Global, Selector

CANDIDATE_TERMS, SAMPLE_ROWS = 7, 300


def _problem() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns of independent terms; the output is made of the third and the sixth."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(CANDIDATE_TERMS, SAMPLE_ROWS))
    output = 2.0 * columns[2] - columns[5] + 0.05 * rng.normal(size=SAMPLE_ROWS)
    return columns, output, np.ones(SAMPLE_ROWS)


def chooses_rows_of_its_columns(selector: Selector) -> None:
    """At least one whole number from 0 on, each at most once; arrays stay as they
    are."""
    given = _problem()
    kept = [a.copy() for a in given]
    found = np.asarray(selector(*given))
    assert found.ndim == 1 and np.issubdtype(found.dtype, np.integer)
    assert len(found) and found.min() >= 0 and found.max() < CANDIDATE_TERMS
    assert len(set(found.tolist())) == len(found)
    for one, two in zip(given, kept, strict=True):
        np.testing.assert_array_equal(one, two)


def finds_what_the_output_is_made_of(selector: Selector) -> None:
    """Find the true ones among independent candidates without much noise, and not
    choose everything."""
    found = np.asarray(selector(*_problem())).tolist()
    assert {2, 5} <= set(found) and len(found) < CANDIDATE_TERMS


def says_the_same_twice(selector: Selector) -> None:
    """The same data give the same terms in the same order."""
    first, second = (np.asarray(selector(*_problem())) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def does_not_look_at_samples_without_weight(selector: Selector) -> None:
    """Values of samples whose weight is zero change nothing."""
    columns, output, weight = _problem()
    weight[::3] = 0.0
    first = np.asarray(selector(columns, output, weight))
    columns, output = columns.copy(), output.copy()
    odd = (
        1e3
        * np.random.default_rng(8).normal(size=(CANDIDATE_TERMS + 1, SAMPLE_ROWS))[
            :, ::3
        ]
    )
    columns[:, ::3], output[::3] = odd[:-1], odd[-1]
    np.testing.assert_array_equal(first, np.asarray(selector(columns, output, weight)))


def does_not_depend_on_the_order_of_terms(selector: Selector) -> None:
    """Candidates in another order: the same terms are chosen."""
    columns, output, weight = _problem()
    order = np.roll(np.arange(CANDIDATE_TERMS), 3)
    first = set(np.asarray(selector(columns, output, weight)).tolist())
    found = np.asarray(selector(columns[order], output, weight))
    assert set(order[found].tolist()) == first


def lives_with_it(selector: Selector, folder: Path) -> None:
    """A network of its terms is refined, saved, loaded and exported."""
    chosen = select(pool(2), plant(), selector)
    assert chosen.is_okay, chosen.detail
    lives(grow(chosen.value, plant(), Global()).value, folder)


CHECKS = (
    chooses_rows_of_its_columns,
    finds_what_the_output_is_made_of,
    says_the_same_twice,
    does_not_look_at_samples_without_weight,
    does_not_depend_on_the_order_of_terms,
    lives_with_it,
)
