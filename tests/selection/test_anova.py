"""Analysis of variance: its level, what it finds, invariances, terms and bad input."""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from anova_problems import ROWS, noise, problem, table, uniform, with_output
from common import some

from jaxnarx.errors import DataError, SpecError
from jaxnarx.selection.anova import sequence as anova_sequence
from jaxnarx.selection.anova.cells import cut, group_tests, lay_out
from jaxnarx.selection.anova.table import AnovaTable, anova, significant_terms
from jaxnarx.settings.anova import Anova

EACH = Anova(familywise=False, significance=0.05)


# --------------------------------------------------------------------- level and power


def test_each_effect_without_influence_passes_at_the_level():
    pool, rows = problem(uniform(3), noise())
    seeds, level = 400, 0.05
    passed = 0
    for seed in range(seeds):
        found = anova(pool, with_output(rows, noise(seed=seed)), 0, EACH)
        assert found.together and len(found.effects) == 6
        passed += len(found.significant)
    tests = 6 * seeds
    # Binomial, four standard deviations either way.
    assert abs(passed - tests * level) < 4 * math.sqrt(tests * level * (1 - level))


@pytest.mark.parametrize("form", some(("balanced", "penalised"), "balanced"))
def test_the_chance_of_any_wrong_effect_is_the_level_for_all_together(form):
    pool, rows = problem(uniform(4, rows=300), noise(300))
    method = Anova(form=form, whole=False, significance=0.1)
    seeds, level = 200, 0.1
    wrong = sum(
        bool(anova(pool, with_output(rows, noise(300, seed)), 0, method).significant)
        for seed in range(seeds)
    )
    # Bonferroni's bound is close to exact for tests that are nearly independent; those
    # of one penalised model share their error and are a little below.
    spread = 4 * math.sqrt(seeds * level * (1 - level))
    assert seeds * level - spread < wrong < seeds * level + spread


@pytest.mark.parametrize("form", ("balanced", "penalised"))
def test_an_interaction_without_main_effects_is_found(form):
    x = uniform(4)
    found = table(x, x[:, 0] * x[:, 1] + 0.3 * noise(), Anova(form=form))
    assert found.significant == ((1, 2),)
    # The main effects are below what their level lets pass: heredity brings the terms.
    assert found.of("x1[t]").p > 0.001 and found.of(2).p > 0.001


@pytest.mark.parametrize("form", ("balanced", "penalised"))
def test_a_three_way_interaction_is_found_as_such(form):
    x = np.sign(uniform(4))
    y = x[:, 0] * x[:, 1] * x[:, 2] + noise()
    found = table(x, y, Anova(form=form, interactions=3, levels=2))
    assert found.significant == ((1, 2, 3),)


@pytest.mark.parametrize("form", ("balanced", "penalised"))
@pytest.mark.parametrize("variables", (4, 8))
def test_line_product_and_square_among_idle_variables(form, variables):
    x = uniform(variables, seed=2)
    y = x[:, 0] + 2 * x[:, 1] * x[:, 2] + 2 * x[:, 3] ** 2 + 0.3 * noise()
    found = table(x, y, Anova(form=form))
    assert set(found.significant) == {(1,), (4,), (2, 3)}


def test_what_only_follows_a_variable_is_dropped_beside_it():
    x = noise(seed=1)[:, None] * np.ones((1, 3))
    x[:, 1] += noise(seed=2)
    x[:, 2] = noise(seed=3)
    y = np.sign(x[:, 0]) + 0.5 * noise(seed=4)
    # Two levels cut at the median: nothing of y is left inside the levels of x1.
    method = Anova(levels=2, interactions=1, whole=False)
    alone = table(x[:, 1:], y, method)
    assert (1,) in alone.significant
    assert table(x, y, method).significant == ((1,),)


def test_of_two_copies_the_first_stays():
    x = uniform(3)
    x[:, 2] = x[:, 0]
    found = table(x, x[:, 0] + 0.3 * noise(), Anova(interactions=1))
    assert not found.together
    assert found.significant == ((1,),)


def test_an_effect_lost_in_what_others_do_is_found_after_them():
    x = uniform(9, seed=5)
    y = 5 * x[:, 0] + 3 * x[:, 1] * x[:, 2] + 0.3 * x[:, 3] + 0.3 * noise()
    code, levels = cut(x[:, 3], 3)
    place = lay_out([code], (levels,), 0.0)
    [alone] = group_tests(place, y - y.mean(), (4,), [(4,)], order=1)
    assert alone.p > 0.01
    found = table(x, y)
    assert set(found.significant) == {(1,), (2, 3), (4,)}
    assert found.of(4).p < 1e-6


def test_cells_found_anew_for_every_step_give_the_same(monkeypatch):
    x = uniform(6, seed=3)
    y = x[:, 0] + 2 * x[:, 1] * x[:, 2] + 0.3 * noise()
    first = table(x, y)
    monkeypatch.setattr(anova_sequence, "MOST_HELD_NUMBERS", 0)
    assert table(x, y) == first and not first.together


# ------------------------------------------------------------------------- invariances


def figures(found: AnovaTable) -> np.ndarray:
    rows = sorted(found.effects, key=lambda e: e.variables)
    return np.array([[e.f, e.p, e.freedom, e.share, e.weight] for e in rows])


FORMS = [Anova(), Anova(whole=False), Anova(form="penalised"), Anova(balance=1.0)]


@pytest.mark.parametrize(
    "method", FORMS, ids=("whole", "one by one", "model", "uneven")
)
def test_rising_transformations_and_scales_change_nothing(method):
    x = uniform(4, seed=6)
    y = x[:, 0] + x[:, 1] * x[:, 2] + noise()
    first = table(x, y, method)
    moved = x.copy()
    moved[:, 1] = np.exp(2 * x[:, 1])
    moved[:, 2] = 1e6 * x[:, 2] ** 3
    second = table(moved, 7 - 300 * y, method)
    assert first.significant == second.significant
    # Rounding of sums over 1,200 samples with an offset, through a p value's log.
    np.testing.assert_allclose(figures(first), figures(second), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("method", FORMS[:3], ids=("whole", "one by one", "model"))
def test_the_order_of_variables_does_not_matter(method):
    x = uniform(4, seed=7)
    y = x[:, 0] + x[:, 1] * x[:, 2] + noise()
    order = [2, 0, 3, 1]
    first, second = table(x, y, method), table(x[:, order], y, method)
    for effect in second.effects:
        here = sorted(order[v - 1] + 1 for v in effect.variables)
        other = first.of(*here)
        assert other.significant == effect.significant
        np.testing.assert_allclose(other.f, effect.f, rtol=1e-8)


@pytest.mark.parametrize("method", FORMS[:3], ids=("whole", "one by one", "model"))
def test_samples_of_no_weight_do_not_count(method):
    x = uniform(3, rows=ROWS + 100)
    y = x[:, 0] + noise(ROWS + 100)
    pool, rows = problem(x, y)
    weight = np.ones(len(y))
    weight[ROWS:] = 0.0
    rows = eqx.tree_at(lambda r: r.weight, rows, jnp.asarray(weight)[None])
    padded = anova(pool, rows, 0, method)
    plain = table(x[:ROWS], y[:ROWS], method)
    assert padded.rows == plain.rows == ROWS
    # The gains come from all samples; F and p have no scale.
    np.testing.assert_allclose(figures(padded), figures(plain), rtol=1e-8, atol=1e-12)


# ------------------------------------------------------------------------------- terms


def test_terms_of_the_kept_effects_and_what_they_contain():
    x = uniform(4)
    y = x[:, 0] + 2 * x[:, 1] * x[:, 2] + 0.3 * noise()
    pool, rows = problem(x, y, degree=3)
    found = anova(pool, rows, 0, Anova())
    assert set(found.significant) == {(1,), (2, 3)}
    allowed = [
        term
        for term, factors in enumerate(pool.factor.tolist())
        if {f for f in factors if f} <= {1} or {f for f in factors if f} <= {2, 3}
    ]
    assert significant_terms(pool, found) == allowed
    # Constant, three powers of x1, and the nine products of x2 and x3 up to degree 3.
    assert len(allowed) == 1 + 3 + 9


def test_noise_leaves_the_constant_alone():
    pool, rows = problem(uniform(4), noise(seed=9))
    found = anova(pool, rows, 0, Anova(significance=1e-6))
    assert [pool.name(t) for t in significant_terms(pool, found)] == ["1"]


def test_the_table_reads_by_name():
    x = uniform(5, seed=1)
    y = x[:, 0] + 2 * x[:, 1] * x[:, 2] + 0.3 * noise()
    x[:, 3], x[:, 4] = 1.0, x[:, 4] > 0
    text = str(table(x, y))
    first, *rest = text.splitlines()
    assert "2 of 11 effects significant at 0.01 for all together" in first
    assert sum(line.startswith("* x1[t] ") for line in rest) == 1
    assert sum(line.startswith("* x2[t] x x3[t] ") for line in rest) == 1
    assert "x5[t] has 2 levels instead of 3" in rest
    assert [line for line in rest if line.endswith("constant")] == [rest[-1]]
    assert len(str(table(uniform(9), y)).splitlines()) < 40


# --------------------------------------------------------------------------- bad input


def finite(found: AnovaTable) -> None:
    assert np.all(np.isfinite(figures(found)))
    assert "nan" not in str(found)


BOTH = pytest.mark.parametrize("form", ("balanced", "penalised"))


@BOTH
def test_a_constant_variable_is_named_and_left_out(form):
    x = uniform(3)
    y = x[:, 0] + noise()
    x[:, 1] = 4.0
    found = table(x, y, Anova(form=form))
    finite(found)
    assert found.of("x2[t]").reason == "constant" and found.levels == (3, 1, 3)
    assert not any({2} < set(e.variables) for e in found.effects)
    assert found.significant == ((1,),)


@BOTH
def test_all_variables_constant_leave_nothing(form):
    found = table(np.ones((50, 2)), noise(50), Anova(form=form))
    finite(found)
    assert not found.significant
    assert [e.reason for e in found.effects] == ["constant"] * 2


@BOTH
def test_binary_and_tied_variables(form):
    x = uniform(3)
    x[:, 0], x[:, 1] = x[:, 0] > 0, np.maximum(x[:, 1], 0.4)
    found = table(x, x[:, 0] * x[:, 2] + 0.3 * noise(), Anova(form=form))
    finite(found)
    assert found.levels == (2, 2, 3)
    assert (1, 3) in found.significant
    assert found.of(1, 3).freedom == 2


@BOTH
def test_a_copy_has_no_interaction_with_its_original(form):
    x = uniform(2)
    x[:, 1] = x[:, 0] ** 3
    found = table(x, x[:, 0] + noise(), Anova(form=form))
    finite(found)
    assert "empty cells" in found.of(1, 2).reason
    assert (1,) in found.significant


def test_fewer_samples_than_cells():
    x = uniform(3, rows=12)
    found = table(x, 5 * x[:, 0] + 0.1 * noise(12))
    finite(found)
    assert not found.together
    x = np.array([[0.0, 0], [0, 1], [1, 0], [1, 1]])
    found = table(x, np.array([1.0, 2, 3, 5]))
    finite(found)
    assert found.of(1, 2).reason == "fewer samples than cells"


@BOTH
@pytest.mark.parametrize("offset", (0.0, 1e6))
def test_a_noise_free_response_has_finite_figures(form, offset):
    x = np.sign(uniform(3))
    found = table(x, x[:, 0] * x[:, 1] + offset, Anova(form=form))
    finite(found)
    assert (1, 2) in found.significant


@BOTH
def test_outputs_and_samples_that_cannot_be_analysed(form):
    x = uniform(2, rows=50)
    method = Anova(form=form)
    with pytest.raises(DataError, match="'y' is constant"):
        table(x, np.full(50, 3.0), method)
    with pytest.raises(DataError, match="at least 4 samples"):
        table(x[:3], noise(3), method)
    pool, rows = problem(x, noise(50))
    with pytest.raises(DataError, match="at least 4 samples"):
        anova(pool, eqx.tree_at(lambda r: r.weight, rows, 0 * rows.weight), 0, method)
    with pytest.raises(DataError, match="'x1.t.' has samples that are not finite"):
        bad = eqx.tree_at(lambda r: r.v, rows, rows.v.at[1, 7].set(jnp.nan))
        anova(pool, bad, 0, method)


def test_a_model_larger_than_the_data_allow_is_refused():
    with pytest.raises(DataError, match="half the 20 samples"):
        table(uniform(6, rows=20), noise(20), Anova(form="penalised"))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("levels", 1),
        ("interactions", 0),
        ("significance", 0.0),
        ("significance", 1),
        ("balance", 1.5),
        ("columns", 0),
    ],
)
def test_settings_that_make_no_sense(field, value):
    with pytest.raises(SpecError, match=field) as caught:
        dataclasses.replace(Anova(), **{field: value})
    assert caught.value.field == field
