"""StepwiseF and Backward against searches that refit by explicit least squares.

All problems share one shape, so that two compiled programs serve most tests.
"""

import common
import numpy as np
import pytest
import selection_oracles as oracles
from common import W, Y
from test_select import PROBLEMS, formed, pool, rms, rows_of

from jaxnarx.errors import SpecError
from jaxnarx.partition import grow
from jaxnarx.regressors import Pool
from jaxnarx.selection import Selection, coefficient_table, select
from jaxnarx.settings import Backward, ForwardOLS, Global, StepwiseF

TERMS = 12
LEVEL = 9.0


def choose(problem: str, method, source: Pool | Selection | None = None, **more):
    return select(source or pool(), common.from_rows(rows_of(problem)), method, **more)


def dense(problem: str, source: Pool | None = None):
    """Columns and output as the search sees them."""
    p, y, _ = formed(rows_of(problem), source or pool())
    return p, y


def constant() -> int:
    return int(np.flatnonzero(~pool().factor.any(axis=1))[0])


def degrees() -> list[int]:
    return (pool().factor > 0).sum(axis=1).tolist()


@pytest.mark.parametrize("f_in, f_out", [(LEVEL, LEVEL), (5.0, 4.0), (3.0, 0.5)])
@pytest.mark.parametrize("problem", PROBLEMS)
def test_stepwise_equals_explicit_refits(problem, f_in, f_out):
    p, y = dense(problem)
    found = choose(
        problem,
        StepwiseF(max_terms=TERMS, f_in=f_in, f_out=f_out, exchange=False),
    )
    expected = oracles.stepwise_f(p, y, f_in, f_out, TERMS, constant=constant())
    assert found.value.terms() == expected.terms
    history = found.stats["history"][0]
    # The first row is the constant alone, which the oracle does not list.
    assert len(history) == len(expected.history) + 1
    for row, reference in zip(history[1:], expected.history, strict=True):
        assert list(row)[1:] == [pool().name(t) for t in reference.terms]
        # Partial F of columns with condition up to 1e4: eight digits are left.
        np.testing.assert_allclose(list(row.values())[1:], reference.partial_f, 1e-7)


@pytest.mark.parametrize("problem", ["white", "slow", "offset"])
def test_a_staged_search_takes_degree_by_degree(problem):
    stages = (2, 3, 2)
    p, y = dense(problem)
    method = StepwiseF(
        max_terms=TERMS, f_in=5.0, f_out=4.0, stages=stages, exchange=False
    )
    expected = oracles.stepwise_f(
        p, y, 5.0, 4.0, TERMS, stages=stages, degrees=degrees(), constant=constant()
    )
    assert choose(problem, method).value.terms() == expected.terms


@pytest.mark.parametrize("problem", PROBLEMS)
def test_backward_equals_elimination_by_explicit_refits(problem):
    p, y = dense(problem)
    forward = choose(problem, ForwardOLS(max_terms=TERMS)).value
    method = Backward(max_terms=TERMS, f_out=LEVEL, exchange=False)
    expected = oracles.backward(p, y, forward.terms(), LEVEL, kept=(constant(),))
    assert choose(problem, method).value.terms() == expected.terms
    again = choose(problem, method, forward).value
    assert again.terms() == expected.terms


@pytest.mark.parametrize("problem", ["slow", "correlated", "records"])
def test_exchange_equals_trying_every_pair(problem):
    p, y = dense(problem)
    start = choose(problem, ForwardOLS(max_terms=TERMS)).value.head(6)
    method = Backward(max_terms=TERMS, f_out=0.0)
    found = choose(problem, method, start).value
    expected = oracles.exchange(p, y, start.terms(), kept=(constant(),))
    assert set(found.terms()) == set(expected)
    sse = oracles.least_squares(p, y, found.terms()).sse
    assert sse <= oracles.least_squares(p, y, start.terms()).sse
    assert found.sse[0, -1] == pytest.approx(sse, rel=1e-9)


def test_the_result_is_that_of_refitting_the_chosen_terms():
    p, y = dense("slow")
    solution = choose("slow", StepwiseF(max_terms=TERMS, f_in=5.0, f_out=4.0))
    value, terms = solution.value, solution.value.terms()
    fit = oracles.least_squares(p, y, terms)
    size = len(terms)
    np.testing.assert_allclose(value.coefficient[0, :size], fit.theta, rtol=1e-7)
    errors = oracles.standard_errors(p, y, terms)
    np.testing.assert_allclose(value.error[0, :size], errors, rtol=1e-7)
    t = value.coefficient[0, :size] / errors
    np.testing.assert_allclose(solution.stats["t"][0, :size], t, rtol=1e-7)
    last = list(solution.stats["history"][0][-1].values())
    np.testing.assert_allclose(last, t**2, rtol=1e-7)


def test_the_table_is_in_physical_units():
    solution = choose("white", StepwiseF(max_terms=TERMS))
    lines = coefficient_table(solution.value).splitlines()
    assert len(lines) == 2 + solution.value.size()
    network = grow(solution.value, common.from_rows(rows_of("white")), Global()).value
    physical = dict(network.equations()[0]["terms"])
    for line, t in zip(lines[2:], solution.stats["t"][0], strict=False):
        name, _, coefficient, _, shown_t, _ = line.split()
        assert float(coefficient) == pytest.approx(physical[name], rel=1e-5)
        assert float(shown_t) == pytest.approx(t, abs=0.005)


def test_criteria_of_every_nested_size_are_those_of_refits():
    p, y = dense("correlated")
    physical = y * rms(rows_of("correlated"))[Y]
    stats = choose("correlated", ForwardOLS(max_terms=8)).stats
    terms = choose("correlated", ForwardOLS(max_terms=8)).value.terms()
    for n in range(1, 9):
        some, at = terms[:n], (0, n - 1)
        press = oracles.press_by_leave_one_out(p, y, some)
        assert stats["press"][at] == pytest.approx(press, rel=1e-8)
        fpe = oracles.fpe(p, physical, some)
        assert stats["fpe"][at] == pytest.approx(fpe, rel=1e-9)
        known = oracles.information(p, physical, some)
        for name in ("aic", "aicc", "bic"):
            assert stats[name][at] == pytest.approx(getattr(known, name), rel=1e-9)
        adjusted = oracles.adjusted_r2(p, y, some)
        assert stats["adjusted_r2"][at] == pytest.approx(adjusted, abs=1e-10)
        if n > 1:
            overall = oracles.overall_f(p, y, some)
            assert stats["overall_f"][at] == pytest.approx(overall, rel=1e-8)


def test_weights_are_those_of_the_squared_error():
    rows = rows_of("white")
    rng = np.random.default_rng(5)
    weights = [rng.random(len(r)) for r in rows]
    p, y, w = formed(rows, pool(), weights)
    method = StepwiseF(max_terms=TERMS, f_in=5.0, f_out=4.0, exchange=False)
    found = choose("white", method, weights=weights)
    expected = oracles.stepwise_f(p, y, 5.0, 4.0, TERMS, constant=constant(), weights=w)
    assert found.value.terms() == expected.terms


def test_a_neighbour_leaves_once_the_true_terms_are_in():
    """The thesis's point: forward search keeps what stepwise search takes back."""
    solution = choose("slow", StepwiseF(max_terms=TERMS))
    forward = choose("slow", ForwardOLS(max_terms=TERMS)).value
    forward = forward.head(solution.value.size())
    p, y = dense("slow")
    f = oracles.partial_f(p, y, solution.value.terms())
    assert np.delete(f, 0).min() >= solution.stats["f_level"] * (1 - 1e-9)
    stepwise = oracles.least_squares(p, y, solution.value.terms()).sse
    assert stepwise <= oracles.least_squares(p, y, forward.terms()).sse * (1 + 1e-9)


def test_the_default_level_is_the_quantile_over_all_candidates():
    from scipy.stats import f

    solution = choose("white", StepwiseF(max_terms=TERMS, significance=0.05))
    samples = int(solution.value.samples[0])
    # 84 candidates; one variance, 12 coefficients at most.
    expected = f.isf(0.05 / len(pool()), 1, samples - TERMS)
    assert solution.stats["f_level"] == pytest.approx(expected, rel=1e-9)


def test_forced_terms_stay_and_forbidden_ones_stay_out():
    free = choose("white", StepwiseF(max_terms=TERMS)).value.names
    useless, needed = "b[t-1]^3", free[1]
    assert useless not in free
    method = StepwiseF(max_terms=TERMS, forced=(useless,), forbidden=(needed,))
    names = choose("white", method).value.names
    assert names[:2] == ["1", useless]
    assert needed not in names


@pytest.mark.parametrize("text", ["y[t-1]*a[t-1]", "a[t-1] * y[t-1]", "b[t-2]^2"])
def test_terms_are_found_in_any_order_of_their_factors(text):
    names = choose("white", ForwardOLS(max_terms=TERMS, forced=(text,))).value.names
    assert names[1] in {"a[t-1]*y[t-1]", "b[t-2]^2"}


@pytest.mark.parametrize("text", ["c[t-1]", "a[t-1]^4", "a[t-1]*b[t-1]*a[t-2]^2"])
def test_an_unknown_forced_term_is_named(text):
    with pytest.raises(SpecError, match="forced"):
        choose("white", ForwardOLS(max_terms=3, forced=(text,)))


def test_several_outputs_at_once_are_one_by_one():
    both = pool(("y", "w"))
    method = StepwiseF(max_terms=TERMS, f_in=5.0, f_out=4.0, exchange=False)
    together = choose("white", method, both).value
    rows = rows_of("white")
    for o, output in enumerate((Y, W)):
        p, y, _ = formed(rows, both, output=output)
        first = constant_of(both)
        expected = oracles.stepwise_f(p, y, 5.0, 4.0, TERMS, constant=first)
        assert together.terms(o) == expected.terms


def constant_of(source: Pool) -> int:
    return int(np.flatnonzero(~source.factor.any(axis=1))[0])


def test_levels_that_contradict_are_refused():
    with pytest.raises(SpecError, match="f_out"):
        StepwiseF(f_in=4.0, f_out=5.0)
    with pytest.raises(SpecError, match="give f_in too"):
        choose("white", StepwiseF(max_terms=TERMS, f_out=1e3))


def test_pure_noise_gives_the_constant_alone():
    rows = [rows_of("white")[0].copy()]
    rows[0][:, 2] = np.random.default_rng(8).normal(size=len(rows[0]))
    data = common.from_rows(rows)
    for method in (StepwiseF(max_terms=TERMS), Backward(max_terms=TERMS)):
        assert select(pool(), data, method).value.names == ["1"]
