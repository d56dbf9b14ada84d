"""Candidates with past outputs: settings that make sense for the data."""

import dataclasses

import numpy as np
import pytest
from search_problems import plant

from jaxnarx.data import Dataset
from jaxnarx.identification.narx_candidates import (
    LARGEST_POOL,
    make_narx_pool,
    propose_narx,
)
from jaxnarx.identification.pools import make_pool
from jaxnarx.partition import DataProfile
from jaxnarx.regressors import Pool, parse_variable
from jaxnarx.settings import PRESETS, ForwardOLS, Global, Lolimot, SimulationError

LOOK = DataProfile("w", (None,), (3,), rise=4.0, memory=20, reach=20, every=1)


def wide(inputs: int) -> Dataset:
    rng = np.random.default_rng(0)
    return Dataset.from_arrays(
        rng.normal(size=(50, inputs)),
        rng.normal(size=(50, 1)),
        inputs=[f"u{n}" for n in range(inputs)],
        outputs=["w"],
        sample_time=1.0,
    )


def test_every_candidate_has_a_name_and_more_terms_to_choose_from_than_it_takes():
    data, seen = plant(2), []
    for family, (name,), method in propose_narx(data, LOOK):
        seen.append((family, name))
        assert isinstance(method.pool, Pool) and isinstance(method.select, ForwardOLS)
        assert isinstance(method.refine, SimulationError)
        assert family == ("LOLIMOT" if isinstance(method.grow, Lolimot) else family)
        assert method.select.max_terms is not None
        assert method.select.max_terms <= len(method.pool)
        if isinstance(method.grow, Global):
            assert method.select.max_terms < len(method.pool)
            assert f"{method.select.max_terms} terms" in name
        assert len(make_pool(method.pool, data.channels)) == len(method.pool)
    assert len(seen) == len(set(seen)) >= PRESETS["good"].fed_back


def test_lags_begin_at_the_dead_time_beside_a_recent_one():
    pool = make_narx_pool(plant(2), LOOK, 2, 2)
    assert pool is not None
    assert pool.variable_names == ["u[t-1]", "u[t-3]", "u[t-4]", "w[t-1]", "w[t-2]"]
    assert pool.outputs == (1,) and pool.degree == 2


def test_local_models_are_scheduled_on_what_is_known():
    data = plant(2)
    for profile in (LOOK, dataclasses.replace(LOOK, dead_time=(0,))):
        local = [m for f, _, m in propose_narx(data, profile) if f == "LOLIMOT"]
        assert local
        for method in local:
            assert isinstance(method.grow, Lolimot)
            rows = [parse_variable(data.channels, t) for t in method.grow.scheduling]
            assert [(row[0], row[1]) for row in rows] == [
                (0, profile.dead_time[0]),
                (2, 1),
            ]


@pytest.mark.parametrize("inputs", [1, 4, 12, 40])
def test_pools_stay_small_however_many_inputs(inputs):
    data = wide(inputs)
    profile = dataclasses.replace(
        LOOK, levels=(None,) * inputs, dead_time=(0,) * inputs
    )
    every = list(propose_narx(data, profile))
    assert every, "local models at least"
    for _, _, method in every:
        assert isinstance(method.pool, Pool)
        assert isinstance(method.grow, Lolimot) or len(method.pool) <= LARGEST_POOL
    if inputs == 40:
        assert {family for family, _, _ in every} == {"LOLIMOT"}
