"""Choosing a size, cutting a selection to it, and errors along the path."""

import common
import numpy as np
import pytest
import selection_oracles as oracles
from common import Y
from test_select import formed, pool, rms, rows_of

from jaxnarx.errors import SpecError
from jaxnarx.partition import grow
from jaxnarx.selection import choose, criteria_of, errors_along, select
from jaxnarx.selection.sizes import largest_variance
from jaxnarx.settings import ForwardOLS, Global, StepwiseF
from jaxnarx.simulation import predict, simulate

TERMS = 8
METHOD = ForwardOLS(max_terms=TERMS)


@pytest.fixture(scope="module")
def data():
    return common.from_rows(rows_of("white"))


@pytest.fixture(scope="module")
def validation():
    return common.from_rows(rows_of("slow"))


@pytest.fixture(scope="module")
def solution(data):
    return select(pool(), data, METHOD)


@pytest.mark.parametrize("name", ["aic", "aicc", "bic", "fpe", "press"])
def test_the_smallest_criterion_names_the_size(solution, name):
    values = solution.stats[name][0]
    size = choose(solution.value, name)
    assert values[size - 1] == values.min()
    np.testing.assert_array_equal(criteria_of(solution.value)[name], values)


def test_cp_takes_the_noise_of_the_whole_pool(solution, data):
    p, y, _ = formed(rows_of("white"), pool())
    terms, every = solution.value.terms(), range(len(pool()))
    expected = [oracles.cp(p, y, terms[: n + 1], every) for n in range(len(terms))]
    noise = largest_variance(solution.value, data)
    found = criteria_of(solution.value, variance=noise)["cp"]
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-6)
    assert choose(solution.value, "cp", train=data) == np.argmin(expected) + 1


def test_cp_of_a_stepwise_search_is_not_its_size_by_construction(data):
    value = select(pool(), data, StepwiseF(max_terms=12)).value
    noise = largest_variance(value, data)
    assert "cp" not in criteria_of(value)
    cp = criteria_of(value, variance=noise)["cp"]
    assert abs(cp[-1] - len(cp)) > 0.1


def test_a_pool_with_more_terms_than_rows_tells_no_noise(solution, data):
    few = common.from_rows([rows_of("white")[0][: len(pool())]])
    assert largest_variance(solution.value, few) is None
    with pytest.raises(SpecError, match="more rows than the .* terms of the pool"):
        choose(solution.value, "cp", train=few)
    with pytest.raises(SpecError, match="as `train`"):
        choose(solution.value, "cp")


def test_criteria_are_of_errors_in_the_unit_of_the_output(solution, data):
    """(5.35) by hand from the residual of the chosen terms, refitted."""
    p, y, _ = formed(rows_of("white"), pool())
    y = y * rms(rows_of("white"))[Y]
    terms = solution.value.terms()
    found = solution.stats["fpe"][0]
    for n in (1, len(terms)):
        theta = np.linalg.lstsq(p[:, terms[:n]], y, rcond=None)[0]
        sse, size = np.sum((y - p[:, terms[:n]] @ theta) ** 2), len(y)
        fpe = size * np.log(sse / size) + size * np.log((size + n) / (size - n))
        assert found[n - 1] == pytest.approx(fpe, rel=1e-9)


@pytest.mark.parametrize("name", ["adjusted_r2", "overall_f"])
def test_of_some_criteria_the_largest_counts(solution, name):
    assert choose(solution.value, name) == int(np.argmax(solution.stats[name][0])) + 1


def test_mdl_is_another_name_for_bic(solution):
    assert choose(solution.value, "mdl") == choose(solution.value, "bic")


def test_the_true_size_is_found_by_bic(solution):
    # five true terms without the constant; the process of test_select
    assert choose(solution.value, "bic") == 6


@pytest.mark.parametrize("size", [1, 4, TERMS, 50])
def test_a_cut_selection_is_that_of_a_shorter_search(solution, data, size):
    cut = solution.value.head(size)
    short = select(pool(), data, ForwardOLS(max_terms=min(size, TERMS))).value
    assert cut.names == short.names
    for name in ("coefficient", "error", "sse", "press", "err"):
        np.testing.assert_allclose(
            getattr(cut, name), getattr(short, name), rtol=1e-9, atol=1e-12
        )


def test_errors_along_the_path_are_those_of_every_size(solution, data, validation):
    found = errors_along(solution.value, data, validation)
    y = np.concatenate([r.y[:, :1] for r in validation])
    for size in (2, 5, TERMS):
        network = grow(solution.value.head(size), data, Global()).value
        for name, verb in (("one_step", predict), ("free_run", simulate)):
            run = verb(network, validation).value
            keep = np.concatenate(run.scored)
            e = (np.concatenate(run.outputs) - y)[keep]
            expected = np.sqrt(np.mean(e**2)) / y[keep].std()
            if run.diverged[0].any():
                expected = np.inf
            # the same least squares by another factorisation
            assert found[name][size - 1, 0] == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("name", ["one_step", "free_run"])
def test_validation_may_choose_the_size(solution, data, validation, name):
    errors = errors_along(solution.value, data, validation)[name][:, 0]
    size = choose(solution.value, name, train=data, validation=validation)
    assert errors[size - 1] == errors.min()


def test_what_cannot_be_chosen_by_is_refused(solution, data):
    with pytest.raises(SpecError, match="aicc"):
        choose(solution.value, "aic2")
    with pytest.raises(SpecError, match="validation"):
        choose(solution.value, "free_run", train=data)
    with pytest.raises(SpecError, match="at least 1"):
        solution.value.head(0)
    both = select(pool(("y", "w")), data, METHOD).value
    with pytest.raises(SpecError, match="several outputs"):
        choose(both)
    assert 1 <= choose(both, output="w") <= TERMS


def test_a_narrowed_pool_holds_the_chosen_terms(solution, data):
    narrow = solution.value.narrow_pool()
    assert set(narrow.names) == set(solution.value.names)
    again = select(narrow, data, METHOD).value
    assert again.names == solution.value.names
