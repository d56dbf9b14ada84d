"""Term selection against a dense Householder implementation, its limits and refusals.

The problems share one shape (298 usable rows, 84 candidates), so that most tests run
the same compiled search.
"""

import dataclasses
import faulthandler
from functools import cache

import common
import jax
import numpy as np
import oracles
import pytest
from common import A, B, Y

from jaxnarx.data import Channel, Channels, Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.regressors import Pool, polynomial_pool
from jaxnarx.selection import select
from jaxnarx.settings import ForwardOLS

SCALE = np.array([1500.0, 0.02, 30.0, 4.0])
"""Physical sizes of a, b, y, w: selection may not depend on them."""
LENGTH = 300
TERMS = 8
PLAIN = ForwardOLS(max_terms=TERMS, constant="candidate")
"""What the dense search does: the constant is a candidate like others."""


def excitation(kind: str, length: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng([seed, length])
    u = rng.normal(size=(length + 100, 2))
    if kind == "slow":
        for t in range(1, len(u)):
            u[t] = 0.95 * u[t - 1] + np.sqrt(1 - 0.95**2) * u[t]
    if kind == "correlated":
        u[:, 1] = u[:, 0] + 0.1 * u[:, 1]
    if kind == "offset":
        u += 2.0
    return u[100:]


TRUE = {
    "y[t-1]": 0.5,
    "a[t-1]": 0.7,
    "a[t-1]*b[t-2]": 0.4,
    "b[t-1]^2*y[t-2]": -0.1,
    "b[t-2]": -0.3,
}


def respond(u: np.ndarray, noise: float, seed: int) -> np.ndarray:
    """y follows `TRUE`, w something else; equation noise."""
    rng = np.random.default_rng([seed, 77])
    e = noise * rng.normal(size=u.shape)
    a, b = u.T
    y, w = np.zeros((2, len(u)))
    for t in range(2, len(u)):
        y[t] = 0.5 * y[t - 1] + 0.7 * a[t - 1] + 0.4 * a[t - 1] * b[t - 2] + e[t, 0]
        y[t] += -0.1 * b[t - 1] ** 2 * y[t - 2] - 0.3 * b[t - 2]
        w[t] = 0.6 * w[t - 1] + 0.3 * y[t - 1] * b[t - 1] - 0.5 * b[t - 2] + e[t, 1]
    return np.column_stack([y, w])


def record(kind: str, length: int = LENGTH, seed: int = 0, noise: float = 0.1):
    u = excitation(kind, length, seed)
    return np.column_stack([u, respond(u, noise, seed)]) * SCALE


def masked_records() -> list[np.ndarray]:
    """Four records with gaps in every channel."""
    rows = [record("slow", n, seed=n) for n in (120, 61, 3, 150)]
    rng = np.random.default_rng(3)
    for r in rows[:2] + rows[3:]:
        r[rng.random(r.shape) < 0.02] = np.nan
    return rows


PROBLEMS = {
    "white": lambda: [record("white")],
    "slow": lambda: [record("slow", seed=1)],
    "correlated": lambda: [record("correlated", seed=2)],
    "offset": lambda: [record("offset", seed=3)],
    "records": masked_records,
}


@cache
def rows_of(problem: str) -> list[np.ndarray]:
    return PROBLEMS[problem]()


@cache
def pool(outputs: tuple[str, ...] = ("y",), degree: int = 3) -> Pool:
    lags: dict[str, tuple[int, ...]] = {"y": (1, 2), "w": (1,)}
    return polynomial_pool(
        common.CHANNELS,
        outputs=list(outputs),
        input_lags=(1, 2),
        output_lags={name: lags[name] for name in outputs},
        degree=degree,
    )


def plain(**settings) -> ForwardOLS:
    return dataclasses.replace(PLAIN, **settings)


def choose(rows, method: ForwardOLS = PLAIN, source: Pool | None = None, **more):
    return select(source or pool(), common.from_rows(rows), method, **more)


def rms(rows) -> np.ndarray:
    return np.sqrt(np.nanmean(np.concatenate(rows) ** 2, axis=0))


def formed(rows, source: Pool, weights=None, output: int = Y):
    """Candidates, target and weights of all records' usable samples, gain-scaled."""
    p, y, w = [], [], []
    for n, r in enumerate(rows):
        x, usable = oracles.lagged(r / rms(rows), source.variables.rows)
        target = r[:, output] / rms(rows)[output]
        usable &= np.isfinite(target) & np.isfinite(x).all(axis=1)
        p.append(oracles.term_matrix(x[usable], source.factor))
        y.append(target[usable])
        w.append(np.ones(usable.sum()) if weights is None else weights[n][usable])
    return np.concatenate(p), np.concatenate(y), np.concatenate(w)


def assert_equals(solution, expected: oracles.ForwardOLS, output: int = 0):
    """Terms and ERR up to the first near tie; coefficients where there is none.

    Tolerances: orthogonalised twice, the chosen columns are exact to rounding; sums
    over 300 rows and a condition below 1e4 leave ten digits.
    """
    clear = np.append(expected.gaps, 0.0) < 1e-7
    steps = int(np.argmax(clear))
    assert steps >= 4, "the problem is no test: near ties from the start"
    found = solution.value
    assert found.terms(output)[:steps] == expected.indices[:steps].tolist()
    np.testing.assert_allclose(
        found.err[output, :steps], expected.err[:steps], rtol=1e-9, atol=1e-13
    )
    if steps == len(expected.indices):
        used = found.used[output]
        np.testing.assert_allclose(
            found.coefficient[output, used], expected.coefficients, rtol=1e-8
        )
    return steps


# equal to the dense implementation ------------------------------------------------


@pytest.mark.parametrize("problem", PROBLEMS)
def test_terms_err_and_coefficients_equal_the_dense_search(problem):
    rows = rows_of(problem)
    p, y, _ = formed(rows, pool())
    solution = choose(rows)
    expected = oracles.forward_ols_dense(p, y, TERMS)
    assert assert_equals(solution, expected) == TERMS
    assert solution.status_name == "ok"
    np.testing.assert_allclose(solution.value.gain, rms(rows), rtol=1e-13)
    assert solution.stats["samples"] == [len(y)]


def test_degree_four_equals_the_dense_search():
    rows, source = rows_of("white"), pool(degree=4)
    solution = choose(rows, source=source)
    p, y, _ = formed(rows, source)
    assert p.shape[1] == 210
    assert_equals(solution, oracles.forward_ols_dense(p, y, TERMS))


def test_nested_sums_of_squares_and_criteria_are_those_of_refitted_models():
    rows = rows_of("slow")
    p, y, _ = formed(rows, pool())
    solution = choose(rows)
    terms = solution.value.terms()
    for n in range(1, TERMS + 1):
        theta = np.linalg.lstsq(p[:, terms[:n]], y, rcond=None)[0]
        sse = np.sum((y - p[:, terms[:n]] @ theta) ** 2)
        # 1 - sum(ERR) cancels: absolute in the output's energy.
        np.testing.assert_allclose(
            solution.stats["sse"][0, n - 1], sse, rtol=0, atol=1e-12 * float(y @ y)
        )
        physical = sse * rms(rows)[Y] ** 2
        aic = len(y) * np.log(physical / len(y)) + 2 * n
        np.testing.assert_allclose(solution.stats["aic"][0, n - 1], aic, rtol=1e-9)
        bic = aic + n * (np.log(len(y)) - 2)
        np.testing.assert_allclose(solution.stats["bic"][0, n - 1], bic, rtol=1e-9)
    assert solution.stats["cond"][0] == pytest.approx(
        np.linalg.cond(p[:, terms] / np.linalg.norm(p[:, terms], axis=0)), rel=1e-8
    )


def test_several_outputs_at_once_are_one_by_one():
    both = pool(("y", "w"), degree=2)
    rows = rows_of("white")
    together = choose(rows, source=both)
    assert together.value.index.shape == (2, TERMS)
    for o, signal in enumerate((Y, Y + 1)):
        p, y, _ = formed(rows, both, output=signal)
        assert_equals(together, oracles.forward_ols_dense(p, y, TERMS), output=o)
        alone = Pool(both.variables, both.factor, both.channels, (o,))
        single = choose(rows, source=alone).value
        assert single.names == together.value.names_of("yw"[o])
        np.testing.assert_allclose(single.err[0], together.value.err[o], rtol=1e-10)
    with pytest.raises(SpecError, match="names_of"):
        _ = together.value.names
    with pytest.raises(SpecError, match=r"'a'; have \['y', 'w'\]"):
        together.value.names_of("a")


def test_weights_enter_the_squared_error_once():
    rows = rows_of("white")
    rng = np.random.default_rng(5)
    weights = [rng.uniform(0.0, 2.0, size=LENGTH) * (rng.random(LENGTH) > 0.3)]
    p, y, w = formed(rows, pool(), weights)
    expected = oracles.forward_ols_dense(p, y, TERMS, weights=w)
    assert assert_equals(choose(rows, weights=weights), expected) == TERMS
    plain = choose(rows)
    assert not np.allclose(plain.value.err, choose(rows, weights=weights).value.err)


def test_a_sample_of_weight_zero_may_hold_anything():
    rows = [rows_of("white")[0].copy()]
    bad = np.arange(LENGTH) % 50 == 20
    rows[0][bad, Y] = 1e3 * SCALE[Y]
    # Nor may it be seen as a lag, one or two samples later.
    weights = [1.0 - (bad | np.roll(bad, 1) | np.roll(bad, 2))]
    p, y, w = formed(rows, pool(), weights)
    expected = oracles.forward_ols_dense(p, y, TERMS, weights=w)
    assert assert_equals(choose(rows, weights=weights), expected) == TERMS


# stops ----------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 3, 6])
def test_rho_stops_at_the_first_size_that_explains_enough(count):
    rows = rows_of("white")
    whole = choose(rows).value
    left = 1.0 - np.cumsum(whole.err[0])
    rho = 0.5 * (left[count - 1] + left[count])
    # Between two sizes: the larger one is the first below.
    stopped = choose(rows, plain(rho=float(rho)))
    assert stopped.status_name == "ok"
    assert stopped.stats["count"] == [count + 1]
    assert stopped.value.names == whole.names[: count + 1]
    np.testing.assert_array_equal(stopped.value.err[0, count + 1 :], 0.0)


def test_tau_passes_over_what_is_mostly_explained():
    rows = rows_of("slow")
    p, y, _ = formed(rows, pool())
    tau = 0.3
    solution = choose(rows, plain(tau=tau))
    expected = oracles.forward_ols_dense(p, y, TERMS, tau=tau)
    assert assert_equals(solution, expected) >= 4
    assert solution.value.names != choose(rows).value.names
    assert np.all(remaining(p, solution.value.terms()) > tau)
    assert np.any(remaining(p, choose(rows).value.terms()) < tau)


def remaining(p, terms, *, relative: bool = True) -> np.ndarray:
    """Squared norm of every chosen column off those before it."""
    r = np.linalg.qr(p[:, terms]).R
    return np.diagonal(r) ** 2 / (np.sum(r**2, axis=0) if relative else 1.0)


def test_the_thesis_threshold_is_on_the_squared_norm_itself():
    rows = rows_of("slow")
    p, _, _ = formed(rows, pool())
    without = remaining(p, choose(rows).value.terms(), relative=False)
    threshold = float(np.median(without))
    assert without.min() < threshold
    solution = choose(rows, plain(tau_absolute=threshold))
    terms = solution.value.terms()
    assert len(terms) > 2
    assert np.all(remaining(p, terms, relative=False) > threshold)


def test_no_candidate_left_is_a_status_of_its_own():
    rows = rows_of("white")
    solution = choose(rows, plain(tau_absolute=1e12))
    assert solution.status_name == "pool_exhausted"
    assert solution.is_okay
    assert solution.value.names == []


def test_a_pool_smaller_than_asked_for_is_exhausted():
    source = pool(degree=1)
    solution = choose(rows_of("white"), source=source)
    assert sorted(solution.value.names) == sorted(source.names)
    assert len(source) < TERMS
    assert solution.status_name == "pool_exhausted"


def test_a_small_pool_needs_rows_for_its_own_terms_only():
    # Seven terms, ten rows, twenty terms allowed; a test below shares the shape.
    rows = [rows_of("white")[0][:12]]
    assert choose(rows, plain(max_terms=20), pool(degree=1)).value.names


def test_collinear_terms_are_said():
    # a moves by rounding alone: beside it the constant, added last, tells nothing.
    rows = [rows_of("white")[0].copy()]
    rows[0][:, A] = 1e3 + 1e-12 * rows[0][:, A]
    rows[0][:, Y] += 3 * SCALE[Y]
    solution = choose(rows, plain(constant="after"))
    assert solution.status_name == "unidentifiable"
    assert not solution.is_okay
    assert any(name.startswith("a[") for name in solution.value.names)
    assert "terms of y are collinear" in solution.detail
    assert solution.detail.endswith(", 1")
    assert solution.cond[0] > 1 / np.sqrt(np.finfo(float).eps)


# the constant ---------------------------------------------------------------------


def constant_index() -> int:
    return int(np.flatnonzero(~pool().factor.any(axis=1))[0])


def test_constant_first_makes_err_speak_of_the_centred_output():
    rows = rows_of("offset")
    solution = choose(rows, ForwardOLS(max_terms=TERMS, constant="first"))
    found = solution.value
    assert found.names[0] == "1"
    p, y, _ = formed(rows, pool())
    centred = oracles.forward_ols_dense(p - p.mean(axis=0), y - y.mean(), TERMS - 1)
    assert np.all(centred.gaps > 1e-7)
    assert found.terms()[1:] == centred.indices.tolist()
    share = np.sum((y - y.mean()) ** 2) / np.sum(y**2)
    np.testing.assert_allclose(found.err[0, 0], 1 - share, rtol=1e-12)
    np.testing.assert_allclose(found.err[0, 1:], centred.err * share, rtol=1e-8)
    theta = np.linalg.lstsq(p[:, found.terms()], y, rcond=None)[0]
    np.testing.assert_allclose(found.coefficient[0], theta, rtol=1e-8)


def test_constant_after_is_the_thesis_ending():
    rows = rows_of("offset")
    p, y, _ = formed(rows, pool())
    keep = np.arange(len(pool())) != constant_index()
    expected = oracles.forward_ols_dense(p[:, keep], y, TERMS)
    assert np.all(expected.gaps > 1e-7)
    solution = choose(rows, ForwardOLS(max_terms=TERMS, constant="after"))
    found = solution.value
    assert found.terms() == [*np.flatnonzero(keep)[expected.indices], constant_index()]
    np.testing.assert_allclose(found.err[0, :-1], expected.err, rtol=1e-9)
    theta = np.linalg.lstsq(p[:, found.terms()], y, rcond=None)[0]
    np.testing.assert_allclose(found.coefficient[0], theta, rtol=1e-8)
    # All terms were fitted anew, so the last sum of squares is that of the whole.
    sse = np.sum((y - p[:, found.terms()] @ theta) ** 2)
    np.testing.assert_allclose(solution.stats["sse"][0, -1], sse, rtol=1e-9)


def test_a_constant_under_the_threshold_does_not_stall_the_search():
    # Weights of 0.001 make its squared norm 0.3, below the thesis's threshold of one;
    # cubes are larger. A stall would last for ever: it ends the process instead.
    faulthandler.dump_traceback_later(120, exit=True)
    method = ForwardOLS(max_terms=TERMS, constant="first", tau_absolute=1.0)
    found = choose(rows_of("white"), method, weights=[np.full(LENGTH, 1e-3)])
    faulthandler.cancel_dump_traceback_later()
    assert len(found.value.names) == TERMS and "1" not in found.value.names


# invariances ----------------------------------------------------------------------


def two_records():
    return [record("white", 152, seed=8), record("white", 150, seed=9)]


def assert_same(a, b):
    """The same terms; figures to the rounding of another order of summation."""
    assert a.value.names == b.value.names
    np.testing.assert_allclose(a.value.err, b.value.err, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(a.value.coefficient, b.value.coefficient, rtol=1e-8)


def test_the_order_of_records_does_not_matter():
    rows = two_records()
    assert_same(choose(rows), choose(rows[::-1]))


def test_records_are_one_record_without_the_windows_across_the_border():
    rows = two_records()
    weights = [np.ones(302)]
    weights[0][152:154] = 0.0
    assert_same(choose(rows), choose([np.concatenate(rows)], weights=weights))


def test_the_units_of_channels_do_not_matter():
    rows = two_records()
    factor = np.array([1e-6, 3.0, 1e9, 0.5])
    assert_same(choose(rows), choose([r * factor for r in rows]))


def test_the_order_of_candidates_does_not_matter():
    source = pool()
    order = np.random.default_rng(0).permutation(len(source))
    shuffled = np.random.default_rng(1).permuted(source.factor[order], axis=1)
    other = Pool(source.variables, shuffled, source.channels, source.outputs)
    rows = two_records()
    names = choose(rows, source=other).value.names
    plain = choose(rows).value.names
    assert [sorted(n.split("*")) for n in names] == [
        sorted(n.split("*")) for n in plain
    ]


def test_masked_samples_at_the_end_are_padding():
    rows = two_records()
    longer = [rows[0], np.concatenate([rows[1], np.full((30, 4), np.nan)])]
    assert_same(choose(rows), choose(longer))


def test_one_program_serves_every_dataset_of_one_shape():
    choose(rows_of("white"))
    other = plain(rho=0.1, tau=0.01, tau_absolute=0.1)
    assert common.compilations(lambda: choose(rows_of("slow"))) == 0
    assert common.compilations(lambda: choose(rows_of("offset"), other)) == 0
    # The count does count.
    fresh = jax.jit(lambda x: 3 * x + 1)
    assert common.compilations(lambda: fresh(np.ones(7))) > 0


def test_float32_data_are_searched_in_float32():
    rows = [r.astype(np.float32) for r in rows_of("white")]
    solution = choose(rows)
    assert solution.value.coefficient.dtype == solution.value.err.dtype == np.float32
    p, y, _ = formed(rows_of("white"), pool())
    expected = oracles.forward_ols_dense(p, y, 5)
    # Five clear terms; float32 sums of 300 products.
    assert np.all(expected.gaps > 1e-4)
    assert solution.value.terms()[:5] == expected.indices.tolist()
    np.testing.assert_allclose(solution.value.err[0, :5], expected.err, rtol=1e-3)


# recovery -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["white", "offset"])
def test_a_known_structure_is_recovered(kind):
    rows = [record(kind, seed=11, noise=1e-4)]
    found = choose(rows, ForwardOLS(max_terms=TERMS)).value
    assert set(found.names[:6]) == {"1", *TRUE}
    values = dict(zip(found.names, found.coefficient[0], strict=True))
    gain = rms(rows) / SCALE
    signal = [s for s, _ in pool().variables]
    for name, value in TRUE.items():
        row = pool().factor[pool().names.index(name)]
        scale = np.prod([gain[signal[v - 1]] for v in row if v]) / gain[Y]
        # Noise of 1e-4 on 300 samples, coefficients of order one.
        assert values[name] / scale == pytest.approx(value, abs=2e-4), name


# refusals (numbers of FAULTS.md) --------------------------------------------------


def with_column(signal: int, values) -> list[np.ndarray]:
    rows = [rows_of("white")[0].copy()]
    rows[0][:, signal] = values
    return rows


def test_fault_4_a_constant_input_is_passed_over_and_listed():
    solution = choose(with_column(B, 3.0))
    assert solution.stats["passed_over"] == {"b": "constant"}
    assert not any("b" in name for name in solution.value.names)
    # Exactly as if b had never been offered.
    p, y, _ = formed(with_column(B, 3.0), pool())
    kept = np.flatnonzero(["b[" not in name for name in pool().names])
    expected = oracles.forward_ols_dense(p[:, kept], y, TERMS)
    offered = expected._replace(indices=kept[expected.indices])
    assert_equals(solution, offered)


def test_fault_4_no_excited_input_is_an_error_that_names_them():
    rows = with_column(B, 3.0)
    rows[0][:, A] = 0.0
    with pytest.raises(DataError, match="every input is constant.*a, b") as caught:
        choose(rows)
    assert caught.value.channel == "a"


def test_fault_5_a_constant_output_is_an_error():
    with pytest.raises(DataError, match="output 'y' is constant.*another") as caught:
        choose(with_column(Y, 7.0))
    assert caught.value.channel == "y"


def test_fault_5_constant_in_one_record_only_is_accepted():
    rows = two_records()
    rows[0][:, Y] = 0.0
    assert choose(rows).is_okay


@pytest.mark.parametrize("factor", [1.0, -250.0])
def test_fault_6_of_duplicate_channels_the_first_is_used(factor):
    rows = with_column(B, 0.0)
    rows[0][:, B] = factor * rows[0][:, A]
    solution = choose(rows)
    assert solution.stats["passed_over"] == {"b": "the same as a"}
    assert not any("b[" in name for name in solution.value.names)
    assert any("a[" in name for name in solution.value.names)


def test_a_shifted_channel_is_no_duplicate():
    rows = with_column(B, 0.0)
    rows[0][:, B] = rows[0][:, A] + 100.0
    assert "b" not in choose(rows).stats["passed_over"]


def test_fault_8_too_few_rows_says_how_many_are_needed():
    rows = [record("white", 7, seed=1), record("white", 5, seed=2)]
    with pytest.raises(
        DataError,
        match=r"need at least 9 usable rows after lag 2, the records give 8 "
        r"\(shortest: 'record 2' with 5 rows\); use smaller lags",
    ):
        choose(rows)


def test_fault_8_a_row_without_its_output_does_not_count():
    rows = [rows_of("white")[0][:100].copy()]
    rows[0][13:, Y] = np.nan
    rows[0][:10, Y] = np.nan
    source = polynomial_pool(
        common.CHANNELS, outputs=["y"], input_lags=(1,), output_lags=(), degree=1
    )
    with pytest.raises(DataError, match="at least 4 usable rows.*the records give 3"):
        choose(rows, source=source)


@pytest.mark.parametrize("rows_left", [0, 5])
def test_fault_8_a_row_without_weight_does_not_count(rows_left):
    weights = [(np.arange(LENGTH) - 10 < rows_left) & (np.arange(LENGTH) >= 10)]
    with pytest.raises(DataError, match=f"at least 9 usable rows.*give {rows_left} "):
        choose(rows_of("white"), weights=[w.astype(float) for w in weights])


@pytest.mark.parametrize("length", [2, 3])
def test_fault_8_records_shorter_than_the_lags(length):
    far = polynomial_pool(
        common.CHANNELS, outputs=["y"], input_lags=(1, 4), output_lags=(1,), degree=1
    )
    with pytest.raises(DataError, match="after lag 4, the records give 0"):
        choose([record("white", 50, seed=1)[20 : 20 + length]], source=far)


def test_weights_that_do_not_fit_are_refused():
    rows = two_records()
    with pytest.raises(DataError, match=r"\[152, 150\] samples, weights \[152, 149\]"):
        choose(rows, weights=[np.ones(152), np.ones(149)])
    for bad in (-1.0, np.nan, np.inf):
        weights = [np.ones(152), np.ones(150)]
        weights[1][3] = bad
        with pytest.raises(DataError, match="finite and not negative"):
            choose(rows, weights=weights)


def test_channels_are_found_by_name():
    rows = rows_of("white")[0]
    renamed = Dataset.from_arrays(
        np.column_stack([rows[:, 1], rows[:, 2], rows[:, 0]]),
        rows[:, 3],
        inputs=["b", "y", "a"],
        outputs=["w"],
        sample_time=0.1,
    )
    assert_same(choose([rows]), select(pool(), renamed, PLAIN))
    strange = Channels((Channel("a"), Channel("bb")), common.CHANNELS.outputs)
    other = Dataset.from_arrays(
        rows[:, :2],
        rows[:, 2:],
        inputs=strange.inputs,
        outputs=strange.outputs,
        sample_time=0.1,
    )
    with pytest.raises(SpecError, match="no channel 'b'.*Did you mean 'bb'"):
        select(pool(), other)
