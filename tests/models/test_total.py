"""A weighted sum of networks runs as the parts do, and is one network."""

import dataclasses

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from kinds import sum_part
from test_own_feedback import same

import jaxnarx as jnx
from jaxnarx.confidence import uncertainty
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import cost, local_behaviour
from jaxnarx.linear import set_state_ranges, state_network
from jaxnarx.linear.state_space.gates import add_gates
from jaxnarx.linear.state_space.model import StateSpace
from jaxnarx.models import (
    AdditiveGates,
    GateProducts,
    Network,
    SignedRoot,
    hold_to_range,
    load,
    save,
    total,
)
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


@pytest.fixture(scope="module")
def kinds(data, parts) -> list[Network]:
    """A tree, one that computes a root, and hidden states with gates that add up."""
    every = np.ones((1, 2), bool)
    root = SignedRoot(*jax.device_put((every[:, 0], np.array([-9.0]))))
    model = dataclasses.replace(parts[2].models[0], own=jax.device_put(every))
    model = dataclasses.replace(model, root=root)
    rng = np.random.default_rng(7)
    plant = StateSpace(
        np.array([[0.7, 0.2], [-0.1, 0.5]]),
        rng.normal(size=(2, 2)),
        np.zeros(2),
        rng.normal(size=(1, 2)),
        np.ones((1, 2)),
        np.array([2.0]),
        np.zeros((1, 2)),
        np.ones(1),
    )
    hidden = state_network(plant, data, (0,), window=6)
    hidden = add_gates(set_state_ranges(hidden, data), data, 3, 1)
    models = []
    for one in hidden.models:
        theta = np.array(one.local.coefficient)
        theta[1:, 0] = rng.normal(size=3)
        local = dataclasses.replace(one.local, coefficient=jax.device_put(theta))
        models.append(dataclasses.replace(one, local=local))
    hidden = dataclasses.replace(hidden, models=tuple(models))
    rooted = dataclasses.replace(parts[2], models=(model,))
    found = []
    for one in (parts[0], rooted, hold_to_range(hidden, None)):
        far = np.asarray(one.upper).copy()
        far[0] = 1e4 / float(one.gain[one.signals[0]])  # squares are large
        low, high = jax.device_put((np.append(-far[:1], one.lower[1:]), far))
        found.append(dataclasses.replace(one, lower=low, upper=high))
    return found


def test_parts_of_several_kinds_are_added(kinds, data):
    """A tree, a root and hidden states, with gains that differ."""
    found = total(kinds, SHARE)
    assert not np.array_equal(kinds[2].gain[:3], kinds[0].gain)
    assert found.hidden == kinds[2].hidden
    assert isinstance(found.models[0].validity, GateProducts)
    run = jnx.simulate(found, data).value
    # Hidden channels begin as it suits the sum: they forget that.
    late, history = slice(found.before + 30, None), found.before
    for one, other in zip(
        run.computed, expected(jnx.simulate, kinds, data, history), strict=True
    ):
        np.testing.assert_allclose(one[late], other[late], rtol=1e-6, atol=1e-5)
        assert np.ptp(other[late]) > 0.1
    (first, _) = data
    y = found(first.u, first.y[: found.before])
    np.testing.assert_allclose(y, run.outputs[0], rtol=1e-9, atol=1e-9)


def test_analyses_that_know_no_roots_say_so_and_a_report_goes_on(data, kinds):
    _, rooted, _ = kinds
    verbs = [jnx.diagnose, local_behaviour, jnx.linear.adapt, uncertainty]
    for verb in verbs:
        with pytest.raises(SpecError, match="root"):
            verb(rooted, data)
    assert "a root is computed" in str(jnx.report(rooted, data))


def test_a_sum_of_kinds_is_saved_exported_and_has_a_slope(kinds, data, tmp_path):
    found = total(kinds, SHARE)
    save(found, tmp_path / "m.safetensors")
    assert same(load(tmp_path / "m.safetensors"), found)
    jnx.export(found, data, to=("python",))  # proven against the run
    runs = jnx.prepare(found, data)
    moving, fixed = eqx.partition(found, jnx.freeze(found))

    def loss(moving):
        return jnp.sum(jnx.free_run(eqx.combine(moving, fixed), runs) ** 2)

    leaves, tree = jax.tree.flatten(moving)
    slope = jax.tree.leaves(eqx.filter_jit(eqx.filter_grad(loss))(moving))
    value = eqx.filter_jit(loss)
    for n in (0, 2):  # coefficients of the output and of gates
        k = int(np.argmax(np.abs(np.asarray(slope[n]).ravel())))
        step = np.zeros(leaves[n].size)
        step[k] = 1e-6
        ends = []
        for sign in (1, -1):
            moved = leaves[n] + sign * jnp.asarray(step.reshape(leaves[n].shape))
            ends.append(value(tree.unflatten([*leaves[:n], moved, *leaves[n + 1 :]])))
        central = float(ends[0] - ends[1]) / 2e-6
        np.testing.assert_allclose(np.ravel(slope[n])[k], central, rtol=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        *("other bounds", "validity", "own feedback", "scheduling on y"),
        *("a weight of zero", "gates that look at y"),
    ],
)
def test_what_cannot_be_added_is_refused(change, parts, data):
    one, other, share = parts[0], parts[2], [0.5, 0.5]
    model = other.models[0]
    if change == "other bounds":
        other = dataclasses.replace(other, upper=other.upper * 2)
    if change == "gates that look at y":
        gates = AdditiveGates(*jax.device_put((np.ones((1, 2)), np.ones(1))))
        model = dataclasses.replace(model, validity=gates)
        other = dataclasses.replace(other, models=(model,))
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
