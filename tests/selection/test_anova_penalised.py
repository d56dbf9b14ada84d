"""The penalised form: its closed solution, its partial tests, its limit of columns."""

import dataclasses
import itertools

import anova_oracles as oracle
import numpy as np
import pytest
from anova_problems import layout, noise, table, uniform
from scipy.stats import f as f_distribution

from jaxnarx.errors import DataError
from jaxnarx.selection.anova.cells import cut
from jaxnarx.settings.anova import Anova


def factorial(seed: int):
    """Variables with 3, 3 and 2 values in equal cells, and a response of some."""
    codes, y = layout((3, 3, 2), 8, seed)
    y = 0.5 * y + 0.3 * (codes[:, 0] - 1) + noise(len(y), seed)
    return codes.astype(float), y


@pytest.mark.parametrize("familywise", (True, False))
@pytest.mark.parametrize("seed", range(4))
def test_on_equal_cells_the_weights_have_their_closed_form(familywise, seed):
    x, y = factorial(seed)
    method = Anova(form="penalised", familywise=familywise, interactions=2)
    found = table(x, y, method)
    share = 6 if familywise else 1
    for effect in found.effects:
        level = 1 - method.significance / share
        quantile = f_distribution.ppf(level, effect.freedom, effect.spare)
        exact = max(0.0, 1 - quantile / effect.f)
        np.testing.assert_allclose(effect.weight, exact, atol=1e-9)
        assert effect.significant == (effect.f > quantile)


@pytest.mark.parametrize("seed", range(3))
def test_on_equal_cells_both_forms_find_the_same_squares(seed):
    x, y = factorial(seed)
    settings = Anova(interactions=3, familywise=False)
    balanced = table(x, y, settings)
    model = table(x, y, dataclasses.replace(settings, form="penalised"))
    assert balanced.together
    for effect in balanced.effects:
        other = model.of(*effect.variables)
        assert (effect.freedom, effect.spare) == (other.freedom, other.spare)
        np.testing.assert_allclose(
            [effect.squares, effect.f, effect.weight],
            [other.squares, other.f, other.weight],
            rtol=1e-9,
            atol=1e-12,
        )
        assert effect.significant == other.significant


def test_partial_tests_of_the_full_model_equal_projections():
    x = uniform(3, rows=200, seed=4)
    x[:, 1] += 1.5 * x[:, 0]
    y = x[:, 0] + x[:, 1] * x[:, 2] + noise(200)
    y_scaled = y - y.mean()
    found = table(x, y, Anova(form="penalised"))
    codes = np.column_stack([cut(c, 3)[0] for c in x.T]).astype(int)
    cells = len(np.unique(codes[:, :2], axis=0))
    assert cells == 7, "two cells of x1 and x2 are meant to be empty"
    whole, rank = oracle.left(codes, oracle.effects(3, 2), y_scaled)
    # An interaction contains no other effect here, so its partial F is plain.
    for effect in itertools.combinations(range(3), 2):
        rest = [e for e in oracle.effects(3, 2) if e != effect]
        squares = oracle.left(codes, rest, y_scaled)[0] - whole
        freedom = rank - oracle.left(codes, rest, y_scaled)[1]
        test = found.of(*(v + 1 for v in effect))
        assert (test.freedom, test.spare) == (freedom, len(y) - rank)
        f = squares / freedom / (whole / (len(y) - rank))
        np.testing.assert_allclose(test.f, f, rtol=1e-9)


def test_interactions_that_do_not_fit_are_passed_over_the_weakest_first():
    x = uniform(8, seed=2)
    y = x[:, 0] + 2 * x[:, 1] * x[:, 2] + 0.3 * noise()
    found = table(x, y, Anova(form="penalised", columns=40))
    # 1 + 8 * 2 columns, then five interactions of 4 below 40.
    tested = [e for e in found.effects if not e.reason]
    assert sum(len(e.variables) == 2 for e in tested) == 5
    assert set(found.significant) == {(1,), (2, 3)}
    over = [e for e in found.effects if "passed over" in e.reason]
    assert len(over) == 28 - 5
    with pytest.raises(DataError, match="17 columns"):
        table(x, y, Anova(form="penalised", columns=16))
