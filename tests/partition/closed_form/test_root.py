"""Candidates that model the root of an output; their errors are the output's."""

import nested_problems as problems
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.data import Dataset, groups
from jaxnarx.models import hold_to_range
from jaxnarx.partition import ClosedForm, ClosedSearch, profile_data


@pytest.fixture(scope="module")
def data() -> Dataset:
    """The square of what answers linearly to an input with few high levels."""

    def change(rng, u, _):
        u[:, 0], r = np.exp(5.0 * u[:, 0]), np.zeros(len(u))
        for t in range(1, len(u)):
            r[t] = 0.8 * r[t - 1] + u[t - 1, 0] + 2.0 * u[t - 1, 1]
        return u, r**2 + 5.0 * rng.normal(size=len(u))

    return problems.plant(change)


def found(data: Dataset, *, root: bool) -> list[ClosedForm]:
    seen = profile_data(data, "y")
    search = ClosedSearch(data, seen, groups(data, gap=seen.memory), root=root)
    return list(search.candidates(2, grown_roots=1))


@pytest.fixture(scope="module")
def rooted(data) -> list[ClosedForm]:
    return found(data, root=True)


def best(every: list[ClosedForm]) -> ClosedForm:
    return min(every, key=lambda one: one.free_run)


def test_it_gains_where_an_output_is_skewed(data, rooted):
    assert profile_data(data, "y").skewness > 3
    assert best(rooted).free_run < 0.5 * best(found(data, root=False)).free_run
    assert all(one.family.endswith(", root") for one in rooted)


def test_errors_are_those_of_the_output(data, rooted):
    """Of the free run of the network, held to the trained range."""
    one = best(rooted)
    signals = one.stage.design.signals
    assert signals.root is not None
    run = jnx.simulate(hold_to_range(one.network()), data).value
    for n, (record, stretch) in enumerate(zip(data, signals.stretches, strict=True)):
        first = len(record) - len(stretch.y)
        theirs = signals.to_output(one._runs()[n])
        low, high = one.stage.design.trained_range()
        theirs = signals.root.middle + signals.root.spread * np.clip(theirs, low, high)
        expected = signals.gain[-1] * theirs
        late = slice(first + 40, None)
        np.testing.assert_allclose(
            run.outputs[n][late, 0], expected[40:], rtol=1e-3, atol=1e-3
        )
    for (_, errors), loss in zip(one.held_out_errors(), one.losses(), strict=True):
        np.testing.assert_allclose(np.mean(errors**2), loss, rtol=1e-9)


def test_measured_values_come_back(rooted, data):
    signals = best(rooted).stage.design.signals
    measured = np.concatenate([signals.to_output(s.y) for s in signals.stretches])
    rows = [
        r.y[len(r) - len(s.y) :, 0]
        for r, s in zip(data, signals.stretches, strict=True)
    ]
    scale = np.polyfit(measured, np.concatenate(rows), 1)
    np.testing.assert_allclose(
        np.polyval(scale, measured), np.concatenate(rows), rtol=1e-9
    )


def test_errors_one_step_ahead_are_those_of_the_network(data, rooted):
    one = best(rooted)
    places, errors = one.one_step_errors()
    ahead = np.concatenate(jnx.predict(one.network(), data, 1).value.outputs)[:, 0]
    y = np.concatenate([r.y[:, 0] for r in data])
    signals = one.stage.design.signals
    assert signals.root is not None
    size = signals.root.spread * signals.gain[-1]
    np.testing.assert_allclose((y - ahead)[places] / size, errors, atol=1e-9)
