"""A weighted sum of networks runs as the parts do, and is one network."""

import dataclasses

import common
import equinox as eqx
import jax
import numpy as np
import pytest
from kinds import sum_part
from test_own_feedback import same

import jaxnarx as jnx
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import cost
from jaxnarx.models import Network, load, save, total
from jaxnarx.regressors import Variables

GAIN = np.array([2.0, 0.5, 4.0])
SHARE = 0.5, 0.2, 0.3


@pytest.fixture(scope="module")
def data() -> Dataset:
    rng = np.random.default_rng(5)
    us = [np.cumsum(rng.normal(size=(n, 2)), axis=0) * 0.2 for n in (90, 70)]
    ys = [10 * rng.normal(size=(len(u), 1)) for u in us]  # wide bounds
    return Dataset.from_arrays(
        us, ys, inputs=["a", "b"], outputs=["y"], sample_time=0.5
    )


@pytest.fixture(scope="module")
def parts(data) -> list[Network]:
    return [
        sum_part(data, GAIN, 1, leaves=3, order=2),
        sum_part(data, GAIN, 2, leaves=1, order=0),
        sum_part(data, GAIN, 3, leaves=2, order=1),
    ]


@pytest.fixture(scope="module")
def added(parts) -> Network:
    return total(parts, SHARE)


def expected(verb, parts, data, history: int) -> list[np.ndarray]:
    """The same sum of what the parts answer behind the longest history."""
    late = dataclasses.replace  # parts begin where the sum does
    runs = []
    for part in parts:
        longer = Variables.of([*part.variables.entries, (0, history, None)])
        runs.append(verb(late(part, variables=longer), data).value.outputs)
    return [
        np.tensordot(SHARE, [run[n] for run in runs], axes=1) for n in range(len(data))
    ]


@pytest.mark.parametrize("verb", [jnx.simulate, jnx.predict])
def test_it_answers_with_the_sum_of_what_its_parts_answer(verb, parts, added, data):
    found = verb(added, data).value.outputs
    for one, other in zip(
        found, expected(verb, parts, data, added.history), strict=True
    ):
        mine = slice(added.history, None)
        np.testing.assert_allclose(one[mine], other[mine], rtol=1e-9, atol=1e-9)
        assert np.ptp(other[mine]) > 0.1


def test_weights_are_shares_and_one_part_is_itself(parts, added):
    twice = total(parts, [2 * w for w in SHARE])
    assert eqx.tree_equal(twice, added, rtol=1e-14)
    assert total(parts[:1], [3.0]) is parts[0]


def test_the_step_that_evaluates_all_terms_gives_the_same(added, data, monkeypatch):
    """The loop on collapsed monomials, which a sum of few of them has."""
    quick = jnx.simulate(added, data).value.outputs
    monkeypatch.setattr("jaxnarx.models.feedback.MOST_COLLAPSED_MONOMIALS", 0)
    # One record more: another program, and those of other tests stay.
    more = dataclasses.replace(data, records=(*data.records, data.records[0]))
    slow = jnx.simulate(added, more).value.outputs
    for one, other in zip(quick, slow, strict=False):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12)


def test_it_is_saved_and_told_as_any_other(added, tmp_path):
    save(added, tmp_path / "m.safetensors")
    assert same(load(tmp_path / "m.safetensors"), added)
    left = [row["text"].split("[")[0] for row in added.equations()]
    # The second part has no feedback, the third is the second group.
    assert left == ["y_1"] * 3 + ["y"] + ["y_2"] * 2


def test_gates_that_share_cost_as_any_other(parts, added):
    alone = [cost(part).weights for part in parts]
    own = cost(added).weights
    # Two gates above; their tables can be calibrated, so nothing of them is folded.
    assert own.exponentials == sum(one.exponentials for one in alone) + 2


@pytest.mark.parametrize(
    "change",
    ["another gain", "validity", "own feedback", "scheduling on y", "a weight of zero"],
)
def test_what_cannot_be_added_is_refused(change, parts, data):
    one, other, share = parts[0], parts[2], [0.5, 0.5]
    model = other.models[0]
    if change == "another gain":
        other = dataclasses.replace(other, gain=other.gain * 2)
    if change == "validity":
        other = common.named("by inputs")
        one = dataclasses.replace(other)
    if change == "own feedback":
        model = dataclasses.replace(model, own=jax.numpy.eye(2, dtype=bool))
        other = dataclasses.replace(other, models=(model,))
    if change == "scheduling on y":
        rows = Variables.of([(2, 1, None), (1, 0, None)])
        model = dataclasses.replace(model, scheduling=rows)
        other = dataclasses.replace(other, models=(model,))
    if change == "a weight of zero":
        share = [0.0, 1.0]
    with pytest.raises(SpecError):
        total([one, other], share)
