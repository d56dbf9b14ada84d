"""Networks of one output each, merged, run as they did alone."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.data import Channel, Channels, Dataset
from jaxnarx.errors import SpecError
from jaxnarx.models import (
    Network,
    assemble,
    combine_outputs,
    global_model,
    hold_to_range,
    local_models,
    output_model,
)
from jaxnarx.models.validity import Gaussians
from jaxnarx.regressors import LowPass, Variables, polynomial_pool


@pytest.fixture(scope="module")
def data() -> Dataset:
    rng = np.random.default_rng(5)
    us = [np.cumsum(rng.normal(size=(n, 2)), axis=0) * 0.2 for n in (80, 60)]
    ys = [300 * rng.normal(size=(len(u), 3)) for u in us]  # nothing is held
    return Dataset.from_arrays(
        us, ys, inputs=["a", "b"], outputs=["y", "w", "v"], sample_time=0.5
    )


def network(data: Dataset, output: str, seed: int, *, regions: int = 1) -> Network:
    """Affine in inputs, a filtered one and the output's own past."""
    rng = np.random.default_rng(seed)
    pool = polynomial_pool(
        data.channels,
        outputs=[output],
        input_lags={"a": (0, seed), "b": (1,)},
        output_lags=(1, 2),
        degree=1,
        filters={"b": [LowPass(2.0 * seed)]},
    )
    theta = 0.2 * rng.normal(size=(regions, len(pool)))
    gain = np.array([2.0, 0.5, 4.0, 3.0, 40.0])
    if regions == 1:
        model = global_model(pool.factor, theta[0])
    else:
        centre = jax.device_put(rng.uniform(size=(regions, 1)))
        validity = Gaussians(centre, 0 * centre - 1.0)
        table, one = Variables.of([(0, 3, None)]), np.ones(1)
        local = local_models(pool.factor, theta)
        model = output_model(local, validity, table, 0 * one, one)
    return assemble(pool, data, gain, [model])


@pytest.fixture(scope="module")
def parts(data) -> list[Network]:
    """Of histories 3, 2 and 3 samples, in another order than the channels'."""
    return [
        hold_to_range(network(data, "v", 1, regions=2)),
        hold_to_range(network(data, "y", 2)),
        hold_to_range(network(data, "w", 3)),
    ]


def test_free_run_is_that_of_the_parts(data, parts):
    both = combine_outputs(parts)
    assert both.output_names == ["v", "y", "w"]
    assert both.history == max(one.history for one in parts) == 3
    run = jnx.simulate(both, data).value
    assert not any(x.any() for x in (*run.limited, *run.held))
    for o, one in enumerate(parts):
        # A part starts where its own history allows; filters begin with the record.
        longer = dataclasses.replace(one, variables=wider(one.variables, both.history))
        alone = jnx.simulate(longer, data).value
        for own, together in zip(alone.outputs, run.outputs, strict=True):
            assert np.std(own) > 0.1
            np.testing.assert_allclose(together[:, o], own[:, 0], atol=1e-12)


def wider(table: Variables, history: int) -> Variables:
    """With one more lag that no term has."""
    return Variables.of([*table.entries, (0, history, None)])


def test_a_variable_of_several_parts_is_computed_once(parts):
    both = combine_outputs(parts)
    assert len(set(both.variables.entries)) == len(both.variables)
    assert set(both.variables.entries) == {
        entry for one in parts for entry in one.variables.entries
    }


def test_equations_of_the_parts_are_those_of_the_whole(parts):
    every = [one["text"] for part in parts for one in part.equations()]
    assert [one["text"] for one in combine_outputs(parts).equations()] == every


def test_one_network_is_itself(data, parts):
    alone = combine_outputs(parts[:1])
    assert alone.output_names == ["v"]
    for a, b in zip(
        jnx.simulate(alone, data).value.outputs,
        jnx.simulate(parts[0], data).value.outputs,
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


def test_different_limits_are_refused(parts):
    for other in (hold_to_range(parts[1], None), hold_to_range(parts[1], 0.5)):
        with pytest.raises(SpecError, match="limits"):
            combine_outputs([parts[0], other])
    free = [hold_to_range(one, None) for one in parts]
    assert combine_outputs(free).hold is None


def test_an_output_twice_is_refused(parts):
    with pytest.raises(SpecError, match="two networks"):
        combine_outputs([*parts, parts[0]])


def test_other_channels_and_sample_times_are_refused(parts):
    names = Channels((Channel("a"), Channel("c")), parts[0].channels.outputs)
    slower = dataclasses.replace(parts[1], sample_time=2 * parts[1].sample_time)
    for other in (dataclasses.replace(parts[1], channels=names), slower):
        with pytest.raises(SpecError, match="same channels, sample time"):
            combine_outputs([parts[0], other])
