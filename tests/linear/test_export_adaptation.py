"""C of a network that learns: what it learns is what `adapt` learns."""

from typing import Any

import numpy as np
import pytest
from adapt_problems import dataset, excitation, one_model, plant, two_models

from jaxnarx.errors import DataError, SpecError
from jaxnarx.exporters import adaptation_runner, adaptive_files, export, write_files
from jaxnarx.exporters.compilers import compiler
from jaxnarx.linear._adapt import adapt
from jaxnarx.linear._export_adaptation import adaptive_program, export_adaptation
from jaxnarx.models import total
from jaxnarx.settings import Recursive

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
TIME = 600


@pytest.fixture(scope="module")
def changed():
    """A network, and a record of a plant that has changed, with gaps."""
    u = excitation(TIME)
    network = one_model(dataset(u, plant(u, np.full(TIME, 0.5), noise=0.02)))
    y = plant(u, np.full(TIME, 0.6), noise=0.1)
    y[200:210] = np.nan
    u = u.copy()
    u[400:403] = np.nan
    return network, dataset(u, y, missing="mask")


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"regressors": "simulated", "dead_zone": 0.01},
        # Both undo windows: what came before is brought back.
        {"forgetting": 0.9, "start": 1e4, "growth": 1.01, "excitation": 0.0},
        {"regressors": "simulated", "forgetting": 0.8, "start": 1e4, "growth": 1.01},
    ],
)
def test_the_c_learns_what_adapt_learns(changed, settings: dict[str, Any]):
    network, data = changed
    method = Recursive(**settings)
    found = export_adaptation(network, data, method, name="m")
    assert found.difference["c, adaptation"] < 1e-12
    assert {"m.c", "m.h", "m_adapt.c", "m_adapt.h"} <= set(found.files)
    undone = adapt(network, data, method).stats["restarts"][0]
    assert (undone > 0) == ("growth" in settings)


@pytest.mark.parametrize("settings", [{"estimation": "local"}, {}, {"models": (1,)}])
def test_regions_learn_alone_together_or_some_of_them(settings):
    u = excitation(TIME)
    data = dataset(u, plant(u, np.full(TIME, 0.5), noise=0.02))
    network = adapt(two_models(data), data).value  # a coefficient of zero is no term
    found = export_adaptation(network, data, Recursive(**settings))
    assert found.difference["c, adaptation"] < 1e-12


def test_a_million_samples_of_one_level_neither_blow_up_nor_move(changed, tmp_path):
    network, data = changed
    adaptive = adaptive_program(network, Recursive(forgetting=0.98), "m")
    write_files(tmp_path, export(network, data, name="m").files)
    write_files(tmp_path, adaptive_files(adaptive))
    run = adaptation_runner(tmp_path, adaptive)
    u = np.concatenate([excitation(TIME), np.full(1_000_000, 0.4)])
    noise = 0.002 * np.random.default_rng(0).normal(size=len(u))
    y = np.zeros(len(u))
    for t in range(1, len(u)):
        y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1] + noise[t]
    before = run(u[:TIME, None], y[:TIME, None])
    after = run(u[:, None], y[:, None])
    np.testing.assert_allclose(after, before, atol=0.05)


def test_the_header_states_memory_and_operations(changed):
    network, data = changed
    text = export_adaptation(network, data).texts["model_adapt.h"]
    # Three coefficients: twice the table, a root of nine, three sums, three errors.
    assert "24 numbers in memory" in text and "57 multiplications" in text


def test_sums_and_short_records_are_refused(changed):
    network, data = changed
    with pytest.raises(DataError, match="window of 1000 samples; the longest has 600"):
        export_adaptation(network, data, Recursive(window=1000))
    with pytest.raises(SpecError, match="sum of models"):
        export_adaptation(total([network, network], [1.0, 1.0]), data)
