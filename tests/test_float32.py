"""float32 data runs in float32 throughout: no accidental casts; verbs tell."""

import jax
import numpy as np

import jaxnarx as jnx
from jaxnarx.solution import tell_precision
from jaxnarx.sweep.precision import number_type


def test_float32_stays_float32():
    rng = np.random.default_rng(3)
    u = rng.uniform(-1, 1, (400, 1)).astype(np.float32)
    y = np.zeros((400, 1), np.float32)
    for t in range(1, 400):
        y[t] = 0.7 * y[t - 1] + u[t - 1] + 0.2 * u[t - 1] ** 2
    data = jnx.Dataset.from_arrays(u, y, inputs=["u"], outputs=["y"], sample_time=1.0)
    pool = jnx.polynomial_pool(
        data.channels, input_lags=(1, 2), output_lags=(1,), degree=2
    )
    parts = jnx.Lolimot(scheduling=["u[t-1]"], max_models=2)
    with number_type(float64=False):
        terms = jnx.select(pool, data, jnx.ForwardOLS(max_terms=4))
        net = jnx.grow(terms.value, data, parts)
        steps = jnx.SimulationError(max_steps=2, horizons=())
        fit = jnx.refine(net.value, data, steps)
        for solution in (terms, net, fit):
            assert solution.stats["precision"] == "float32"
            assert solution.detail.count("computed in float32") == 1
        assert tell_precision(lambda: fit)() is fit  # told once, whoever calls whom
        for leaf in jax.tree.leaves(fit.value):
            assert leaf.dtype.kind != "f" or leaf.dtype == np.float32, leaf.dtype
        run = jnx.simulate(fit.value, data).value[0]
        assert jnx.diagnose(fit.value, data).status_name == "ok"
    assert run.dtype == np.float32 and np.all(np.isfinite(run))
    assert np.sqrt(np.mean((run - y)[1:] ** 2)) < 0.05 * y.std()
