"""Growth of a local linear model tree against published curves and a plain version."""

from functools import cache
from typing import Any

import common
import jax
import numpy as np
import oracles
import pytest

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.models import Gaussians, Network
from jaxnarx.partition import grow
from jaxnarx.partition._lolimot import lolimot
from jaxnarx.regressors import polynomial_pool
from jaxnarx.settings import Global, Lolimot
from jaxnarx.simulation import predict

# Published training NRMSE, printed to six decimals (DESIGN section 9). In one dimension
# growth ends there because no further split is allowed.
CURVES = {
    1: [0.602127, 0.390072, 0.198680, 0.198358],
    2: [
        *[0.544439, 0.365469, 0.215300, 0.142034, 0.110022, 0.090782, 0.072288],
        *[0.062162, 0.048693, 0.046219, 0.040753, 0.033456, 0.032087, 0.029373],
        *[0.027575, 0.025671, 0.024634, 0.023574, 0.021947, 0.020655, 0.018866],
        *[0.018058, 0.016542, 0.014898, 0.013875, 0.013625],
    ],
}


def static(u: np.ndarray, y: np.ndarray, **options) -> Dataset:
    names = [f"u{n + 1}" for n in range(u.shape[1])]
    settings = {"inputs": names, "outputs": ["y"], "sample_time": 1.0} | options
    return Dataset.from_arrays(u, y, **settings)


def grown(data: Dataset, method: Lolimot | Global):
    """A local linear model tree over all inputs of the same sample."""
    pool = polynomial_pool(data.channels, input_lags=(0,), output_lags=(), degree=1)
    return grow(pool, data, method)


def published(dims: int) -> Dataset:
    axis = np.linspace(0, 1, 15)
    u = np.stack(np.meshgrid(*[axis] * dims, indexing="ij"), axis=-1).reshape(-1, dims)
    y = 1 / (0.1 + u[:, 0])
    return static(u, y if dims == 1 else y + (2 * u[:, 1]) ** 2)


def centres(net: Network, o: int = 0) -> np.ndarray:
    validity = net.models[o].validity
    assert isinstance(validity, Gaussians)
    return np.asarray(validity.centre)


def nrmse(solution, data: Dataset) -> np.ndarray:
    y = np.concatenate([r.y[:, 0] for r in data])
    gain = float(solution.value.gain[-1])
    return (
        np.sqrt(solution.stats["sse"][0]) * gain / np.sqrt(np.sum((y - y.mean()) ** 2))
    )


@pytest.mark.parametrize("dims", [1, 2])
def test_published_curves(dims):
    data = published(dims)
    scheduling = tuple(f"u{n + 1}[t]" for n in range(dims))
    capacity = {1: 6, 2: 26}[dims]
    method = Lolimot(scheduling, max_models=capacity, k_sigma=0.4, patience=100)
    solution = grown(data, method)
    np.testing.assert_allclose(nrmse(solution, data), CURVES[dims], rtol=0, atol=1e-6)
    stopped = {1: "data", 2: "capacity"}[dims]
    assert solution.stats["stopped"] == [stopped]
    assert solution.status_name == "ok"
    np.testing.assert_array_equal(
        solution.stats["models"][0], np.arange(1, len(CURVES[dims]) + 1)
    )


# against the plain version --------------------------------------------------------

ROWS, DIMS, MODELS, K_SIGMA = 220, 3, 7, 0.35


def problem(seed: int):
    """Regressors, scheduling variables in [0, 1], target, and weights 0, 1 and 2.

    Rows of weight zero hold garbage. The local models have a regressor that does not
    schedule.
    """
    rng = np.random.default_rng(seed)
    z = rng.uniform(size=(ROWS, DIMS))
    z[:2] = [[0.0] * DIMS, [1.0] * DIMS]
    extra = rng.normal(size=ROWS)
    y = np.exp(2 * z[:, 0]) + np.sin(5 * z[:, 1]) * (1 + extra) + z[:, 2] ** 2
    y += 0.05 * rng.normal(size=ROWS)
    p = np.column_stack([np.ones(ROWS), z, extra])
    weight = rng.integers(0, 3, size=ROWS).astype(float)
    weight[:2] = 1.0
    out = weight == 0
    p[out, 1:], y[out], z[out] = 1e3, -1e4, rng.normal(size=(out.sum(), DIMS))
    return p, z, y, weight


_compiled = jax.jit(
    lolimot, static_argnames=("max_models", "kind", "worst", "picks", "first")
)


def compiled(
    p, z, y, weight, *, max_models=MODELS, k_sigma=K_SIGMA, ridge=0.0, **options
):
    arrays = map(common.device, (p.T, z.T, y, weight))
    least = options.pop("least", float(p.shape[1]))
    scalars = {"k_sigma": k_sigma, "ridge": ridge, "least": least}
    scalars = {name: common.device(np.asarray(x)) for name, x in scalars.items()}
    stages = _compiled(*arrays, max_models=max_models, **scalars, **options)
    return jax.tree.map(np.asarray, stages)


@pytest.mark.parametrize("seed", [1, 2])
def test_three_dimensions_with_weights_equal_the_plain_growth(seed):
    p, z, y, weight = problem(seed)
    times = weight.astype(int)
    # The plain version knows no weights: twice is two rows, zero is none.
    once = [np.repeat(a, times, axis=0) for a in (p, z, y)]
    expected = oracles.lolimot(
        once[1], once[2], k_sigma=K_SIGMA, max_models=MODELS, regressors=once[0]
    )
    # A clear choice at every split, so that rounding decides nothing.
    assert min(expected.worst_gap + expected.dim_gap) > 1e-4
    assert len({dim for _, dim in expected.splits}) > 1
    stages = compiled(p, z, y, weight)
    np.testing.assert_array_equal(stages.count, np.arange(1, MODELS + 1))
    variation = np.sum((once[2] - once[2].mean()) ** 2)
    np.testing.assert_allclose(
        np.sqrt(np.asarray(stages.sse) / variation), expected.nrmse, rtol=1e-8
    )
    np.testing.assert_array_equal(stages.low[-1], expected.lower)
    np.testing.assert_array_equal(stages.high[-1], expected.upper)
    # Normal equations: condition squared, about 1e4 here, and a ridge of 1e-12.
    np.testing.assert_allclose(
        stages.theta[-1], expected.coefficients, rtol=1e-6, atol=1e-6
    )


def phi_of(stages, stage: int, z: np.ndarray) -> np.ndarray:
    count = int(stages.count[stage])
    low, high = (np.asarray(a)[stage, :count] for a in (stages.low, stages.high))
    return oracles.box_validity(z, low, high, K_SIGMA)


def test_effective_parameters_are_the_trace_of_the_smoothing_matrices():
    p, z, y, weight = problem(3)
    stages = compiled(p, z, y, weight)
    for stage in (0, MODELS - 1):
        phi = phi_of(stages, stage, z)
        expected = 0.0
        for m in range(phi.shape[1]):
            w = np.diag(phi[:, m] * weight)
            smoother = phi[:, m, None] * p @ np.linalg.solve(p.T @ w @ p, p.T @ w)
            expected += np.trace(smoother)
        np.testing.assert_allclose(stages.effective[stage], expected, rtol=1e-7)
    # One model: all its parameters. Overlapping ones: fewer than they have together.
    assert stages.effective[0] == pytest.approx(5, rel=1e-9)
    assert 5 < float(stages.effective[-1]) < 5 * MODELS


def test_boxes_tile_the_unit_cube():
    p, z, y, weight = problem(4)
    stages = compiled(p, z, y, weight)
    for stage in range(MODELS):
        count = stage + 1
        low, high = (np.asarray(a)[stage, :count] for a in (stages.low, stages.high))
        assert np.prod(high - low, axis=1).sum() == pytest.approx(1.0, rel=1e-14)
        points = np.random.default_rng(0).uniform(size=(200, 1, DIMS))
        inside = np.all((points >= low) & (points < high), axis=2)
        np.testing.assert_array_equal(inside.sum(axis=1), 1)


def test_a_split_without_samples_for_its_parameters_is_forbidden():
    # Fewer rows count: nearly all have weight zero, and growth must end by itself.
    p, z, y, weight = problem(5)
    weight = np.where(np.arange(ROWS) < 30, 1.0, 0.0)
    weight[:2] = 1.0
    p[:30], y[:30] = problem(6)[0][:30], np.arange(30.0) ** 2
    z[:30] = np.random.default_rng(7).uniform(size=(30, DIMS))
    z[:2] = [[0.0] * DIMS, [1.0] * DIMS]
    stages = compiled(p, z, y, weight)
    count = int(stages.count[-1])
    assert 1 < count < MODELS
    used = weight > 0
    low, high = (np.asarray(a)[-1, :count] for a in (stages.low, stages.high))
    for m in range(count):
        for d in range(DIMS):
            middle = (low[m, d] + high[m, d]) / 2
            lower, upper = np.vstack([low, low[m]]), np.vstack([high, high[m]])
            upper[m, d] = lower[-1, d] = middle
            phi = oracles.box_validity(z[used], lower, upper, K_SIGMA)
            assert min(phi[:, m].sum(), phi[:, -1].sum()) < p.shape[1], (m, d)
    # What remains repeats the last stage.
    np.testing.assert_array_equal(stages.sse[count - 1 :], stages.sse[count - 1])
    mass = phi_of(stages, count - 1, z[used]).sum(axis=0)
    assert np.all(mass[[count - 1]] >= p.shape[1])


def test_one_program_serves_every_dataset_and_width():
    compiled(*problem(1))
    others: dict[str, Any] = {"k_sigma": 0.4, "ridge": 0.1, "least": 7.0}
    assert common.compilations(lambda: compiled(*problem(2), **others)) == 0


# the verb -------------------------------------------------------------------------


@cache
def noisy(rows: int = 200) -> Dataset:
    """Four models are best, five and six worse, seven best of all (AICc)."""
    rng = np.random.default_rng(3)
    u = rng.uniform(-2.0, 3.0, size=(rows, 2))
    y = 4 * np.tanh(u[:, 0]) + 5 * u[:, 1] + rng.normal(size=rows)
    return static(u, y)


SCHEDULE = ("u1[t]", "u2[t]")


def criterion(stats) -> np.ndarray:
    """AICc = N ln(SSE/N) + 2 n + 2 n (n + 1) / (N - n - 1), n effective, N = 200."""
    sse, n = stats["sse"][0], stats["effective"][0]
    return 200 * np.log(sse / 200) + 2 * n + 2 * n * (n + 1) / (200 - n - 1)


@pytest.mark.parametrize(("patience", "models"), [(1, 4), (2, 4), (3, 7)])
def test_growth_stops_after_some_deteriorations_and_returns_the_best(patience, models):
    solution = grown(noisy(), Lolimot(SCHEDULE, max_models=10, patience=patience))
    stats = solution.stats
    aicc = criterion(stats)
    np.testing.assert_allclose(stats["aicc"][0], aicc, rtol=1e-12)
    best = models - 1
    assert stats["best"] == [best]
    # Better than all before it, and than the next ones for as long as it waits; by a
    # margin that no rounding reaches.
    others = np.delete(aicc[: best + 1 + patience], best)
    assert np.all(others > aicc[best] + 0.05)
    assert stats["stopped"] == ["criterion"]
    assert solution.status_name == "no_improvement"
    assert int(solution.value.models[0].active.sum()) == models


def test_a_linear_process_needs_one_model():
    rng = np.random.default_rng(3)
    u = rng.uniform(size=(200, 2))
    data = static(u, 3 + u @ [1.0, -2.0] + 0.1 * rng.normal(size=200))
    solution = grown(data, Lolimot(SCHEDULE, max_models=10))
    assert solution.stats["best"] == [0]
    assert solution.status_name == "no_improvement"


def test_units_and_masked_rows_do_not_matter():
    data = noisy()
    method = Lolimot(SCHEDULE, max_models=10)
    record = data.records[0]
    gap = np.full((40, 2), np.nan)
    other = static(
        np.concatenate([record.u * [1e-5, 300.0] + [0.0, 5.0], gap]),
        np.concatenate([record.y * 1e4, gap[:, :1]]),
        missing="mask",
    )
    ours, theirs = (grown(d, method).stats for d in (data, other))
    # An offset of an input is absorbed by the constant.
    np.testing.assert_allclose(theirs["sse"][0], ours["sse"][0], rtol=1e-6)
    np.testing.assert_allclose(theirs["effective"][0], ours["effective"][0], rtol=1e-6)
    assert theirs["best"] == ours["best"]


def test_every_output_has_a_partition_of_its_own():
    rng = np.random.default_rng(5)
    u = rng.uniform(size=(200, 2))
    y = np.column_stack([np.exp(3 * u[:, 0]), np.exp(3 * u[:, 1])])
    both = static(u, y, outputs=["y", "w"])
    method = Lolimot(SCHEDULE, max_models=10, patience=2)
    solution = grown(both, method)
    for o in range(2):
        alone = static(u, y[:, o], outputs=["yw"[o]])
        single = grown(alone, method)
        np.testing.assert_allclose(
            solution.stats["sse"][o], single.stats["sse"][0], rtol=1e-9
        )
        np.testing.assert_array_equal(centres(solution.value, o), centres(single.value))
    first, second = (centres(solution.value, o) for o in range(2))
    assert first.shape != second.shape or np.any(first != second)


@pytest.mark.parametrize(
    ("scheduling", "message"),
    [
        (("u3[t]",), "Did you mean 'u1' or 'u2'|Did you mean 'u2' or 'u1'"),
        (("u1",), r"write 'name\[t\]'"),
        (("y[t]",), r"y\[t-1\]"),
    ],
)
def test_scheduling_variables_are_checked(scheduling, message):
    with pytest.raises(SpecError, match=message) as caught:
        grown(noisy(), Lolimot(scheduling))
    assert caught.value.field in ("scheduling", "u3")


def test_too_few_rows_for_one_local_model():
    with pytest.raises(DataError, match="need at least 4 usable rows.*give 3"):
        grown(noisy(rows=3), Lolimot(SCHEDULE))


def test_names_may_come_as_a_list():
    assert Lolimot(scheduling=list(SCHEDULE)) == Lolimot(scheduling=SCHEDULE)


@pytest.mark.parametrize(
    ("settings", "field"),
    [
        ({"scheduling": ()}, "scheduling"),
        ({"scheduling": ("u1[t]",), "max_models": 0}, "max_models"),
        ({"scheduling": ("u1[t]",), "k_sigma": 0.0}, "k_sigma"),
    ],
)
def test_impossible_settings_are_refused(settings, field):
    with pytest.raises(SpecError) as caught:
        Lolimot(**settings)
    assert caught.value.field == field


# one global model -----------------------------------------------------------------


def test_a_global_model_is_the_least_squares_fit():
    data = common.dataset((80, 60), seed=4)
    pool = polynomial_pool(
        data.channels, outputs=["y"], input_lags=(0, 1), output_lags=(1,), degree=2
    )
    solution = grow(pool, data, Global())
    p, y = [], []
    for n in range(2):
        rows = common.rows_of(data, n)
        x, usable = oracles.lagged(rows, pool.variables.rows)
        p.append(oracles.term_matrix(x, pool.factor)[usable])
        y.append(rows[usable, common.Y])
    theta = np.linalg.lstsq(np.concatenate(p), np.concatenate(y), rcond=None)[0]
    (entry,) = solution.value.equations()
    assert [name for name, _ in entry["terms"]] == pool.names
    np.testing.assert_allclose([c for _, c in entry["terms"]], theta, rtol=1e-9)
    assert solution.status_name == "ok"
    assert solution.rank == [len(pool)]


def test_a_collinear_global_model_is_said():
    data = noisy()
    record = data.records[0]
    twice = static(np.column_stack([record.u, record.u @ [1.0, 2.0]]), record.y)
    solution = grown(twice, Global())
    assert solution.status_name == "unidentifiable"
    assert "terms of y have rank 3 of 4" in solution.detail
    assert solution.cond == [np.inf]
    # Still the best fit: as good as without the third input.
    ones = np.ones((200, 1))
    p = np.concatenate([ones, record.u], axis=1)
    best = p @ np.linalg.lstsq(p, record.y, rcond=None)[0]
    ours = predict(solution.value, twice).value[0]
    np.testing.assert_allclose(ours, best, rtol=1e-9, atol=1e-9)
