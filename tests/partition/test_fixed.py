"""Partitions that are there already, and the stages that a growth keeps."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from common import some
from problems import data, fitted, growth, pool, records

import jaxnarx as jnx
from jaxnarx.errors import SpecError
from jaxnarx.models import AbstractValidity, Gaussians, SigmoidTree
from jaxnarx.partition import grow
from jaxnarx.settings import ForwardOLS, Given, Global, Grid, Lolimot

SCHEDULE = ("u1[t]", "u2[t]")
METHODS = growth("tiny")


def grown() -> jnx.Solution:
    return fitted("tiny", "gaussians")


def to_both(partition: Any, **more: Any) -> jnx.Network:
    """Both outputs in given regions."""
    return grow(pool(outputs=2), data(outputs=2), Given(partition, **more)).value


def same_regions(a: jnx.Network, b: jnx.Network, output: int = 0) -> bool:
    pairs = zip(a.regions(0), b.regions(output), strict=False)
    return all(
        np.isclose(one[name][key], two[name][key], rtol=1e-12)
        for one, two in pairs
        for name in one
        for key in one[name]
    )


def test_the_stages_of_a_growth_are_networks_with_the_errors_it_reports():
    """Every stage's one-step squared error is the one in the figures."""
    (stages,), (sse,) = (grown().stats[k] for k in ("stages", "sse"))
    assert [int(n.models[0].active.sum()) for n in stages] == [1, 2, 3, 4, 5]
    gain = float(grown().value.gain[2])
    for network, expected in zip(stages, sse, strict=True):
        run = jnx.predict(network, data()).value[0]
        found = np.sum(((run - data().records[0].y) / gain) ** 2)
        np.testing.assert_allclose(found, expected, rtol=1e-9)  # sums in another order


def test_a_partition_that_is_handed_on_keeps_its_regions_and_is_fitted_anew():
    """A local model's least squares do not depend on the others: those that were made
    last, the children of the last split, come out as they were grown."""
    network = grown().value
    again = grow(pool(), data(), Given(network)).value
    assert same_regions(network, again)
    last = grown().stats["stages"][0][-1].models[0].local.coefficient
    changed = np.abs(last - again.models[0].local.coefficient).max(axis=1) > 1e-8
    assert not changed[-1] and np.sum(~changed) >= 2


def test_outputs_share_the_regions_of_one():
    network = grown().value
    both = to_both(network)
    assert both.output_names == ["y", "w"]
    assert same_regions(network, both, 0) and same_regions(network, both, 1)
    named = to_both(both, output="w")
    assert same_regions(both, named, 1)


def test_regions_of_their_own_for_every_output():
    """Each output keeps those of the output of its name, also over other variables."""
    first = grow(pool(), data(), Grid("u1[t]", models=(2,))).value
    mixed = to_both(to_both(first))
    assert [list(mixed.regions(o)[0]) for o in (0, 1)] == [["u1[t]"], ["u1[t]"]]
    assert same_regions(first, mixed, 0)


def test_a_gate_drawn_by_hand_in_physical_units():
    """One gate at u1 = 15 of a range from 10 to 30 that the caller names."""
    tree = SigmoidTree(
        direction=jnp.array([[1.0, 0.0]]),
        border=jnp.array([0.25]),
        log_steepness=jnp.log(jnp.array([40.0])),
        path=jnp.array([[1], [-1]]),
    )
    method = Given(tree, scheduling=SCHEDULE, ranges=((10, 30), (-1, 1)))
    network = grow(pool(), data(), method).value
    above, below = network.regions(0)
    assert above == {"u1[t]": {"above": 15.0}} and below == {"u1[t]": {"below": 15.0}}
    data_range = grow(pool(), data(), Given(tree, scheduling=SCHEDULE)).value
    np.testing.assert_allclose(
        data_range.models[0].local.coefficient,
        network.models[0].local.coefficient,
        rtol=1e-9,  # the data span that range
    )


class Halves(AbstractValidity):
    """Two models by a number: no size of a field tells how many there are."""

    trained = ("border",)
    border: Any

    def __call__(self, z, active):
        upper = jnp.where(z[0] > self.border, 1.0, 0.0)
        return jnp.stack([1 - upper, upper])

    def limits(self, width_band):
        return Halves(self.border - 1.0), Halves(self.border + 1.0)

    def check(self, models, dims):
        if (models, dims) != (2, 1):
            raise ValueError(f"halves are 2 of 1 variable, not {models} of {dims}")

    def regions(self, names, offset, span):
        border = float(offset[0] + span[0] * self.border)
        return [{names[0]: {"below": border}}, {names[0]: {"above": border}}]


def test_a_validity_function_tells_by_its_check_how_many_models_there_are():
    found = grow(pool(), data(), Given(Halves(jnp.asarray(0.25)), scheduling=["u1[t]"]))
    assert [len(m) for m in found.value.regions(0)] == [1, 1]
    assert found.value.regions(0)[1] == {"u1[t]": {"above": pytest.approx(15.0)}}
    boxes = Grid(["u1[t]"], borders=[[15.0]], validity="boxes")
    same = grow(pool(), data(), boxes).value
    runs = (jnx.simulate(n, data()).value.outputs[0] for n in (found.value, same))
    np.testing.assert_allclose(*runs, rtol=1e-9)
    with pytest.raises(SpecError, match="halves are 2 of 1 variable, not 1 of 2"):
        grow(pool(), data(), Given(Halves(jnp.asarray(0.25)), scheduling=SCHEDULE))


def test_terms_of_their_own_in_given_regions():
    local = ForwardOLS(max_terms=2)
    network = grow(pool(), data(), Given(grown().value, local=local)).value
    used = np.asarray(network.models[0].local.used).sum(axis=1)
    assert np.all(used <= 2) and used.max() == 2


def test_a_region_without_samples_is_named():
    """A grid drawn for the whole range, data of its lower half."""
    whole = grow(pool(), data(), Grid(("u1[t]",), models=(4,), k_sigma=0.1)).value
    kept = data().records[0].u[:, 0] < 16
    record = data().records[0]
    part = records("tiny", record.u[kept], record.y[kept])
    solution = grow(pool(), part, Given(whole))
    assert solution.status_name == "unidentifiable" and solution.stats["poor"] == [
        [2, 3]
    ]
    assert same_regions(whole, solution.value)


def test_wrong_use_says_what_to_do():
    network = grown().value
    with pytest.raises(SpecError, match="has no output 'z'"):
        grow(pool(), data(), Given(network, output="z"))
    with pytest.raises(SpecError, match="leave `scheduling` out"):
        grow(pool(), data(), Given(network, scheduling=SCHEDULE))
    with pytest.raises(SpecError, match="needs its"):
        grow(pool(), data(), Given(network.models[0].validity))
    with pytest.raises(SpecError, match="do not fit"):
        validity = network.models[0].validity
        grow(pool(), data(), Given(validity, scheduling=("u1[t]",)))
    with pytest.raises(SpecError, match="no partition to take"):
        grow(pool(), data(), Given(fitted("tiny", "global").value))
    with pytest.raises(SpecError, match="no partition 'speed'"):
        grow(pool(), data(), Given("speed"))


# growth that goes on from a partition ---------------------------------------------


@pytest.mark.parametrize(
    "kind", some(["boxes", "gaussians", "compact", "tree"], "tree", "gaussians")
)
def test_a_growth_goes_on_from_the_regions_of_a_network(kind: str):
    """From the third stage on: that stage's regions, fitted anew, then their splits.

    Without overlap local models do not know of each other, so that the whole growth is
    the one that was not interrupted.
    """
    method, whole = METHODS[kind], fitted("tiny", kind)
    third = whole.stats["stages"][0][2]
    on = grow(pool(), data(), method, start=third)
    stages = on.stats["stages"][0]
    assert on.stats["models"][0].tolist() == [3, 4, 5]
    again = grow(pool(), data(), Given(third)).value
    assert same_regions(stages[0], again)
    np.testing.assert_allclose(  # sums in another order
        stages[0].models[0].local.coefficient[:3],
        again.models[0].local.coefficient[:3],
        rtol=1e-7,
    )
    if kind == "boxes":
        assert same_regions(on.value, whole.value)
        np.testing.assert_allclose(
            on.stats["sse"][0], whole.stats["sse"][0][2:], rtol=1e-9
        )
    assert np.all(np.diff(on.stats["sse"][0]) < 0)


def test_a_growth_goes_on_from_regions_drawn_by_hand_and_of_other_data():
    """Two Gaussians of other widths keep place and width but for the one that is
    halved; on other data they keep them in physical units."""
    drawn = Gaussians(jnp.array([[0.25], [0.75]]), jnp.log(jnp.array([[0.1], [0.2]])))
    method = Lolimot("u1[t]", max_models=3, criterion="none")
    on = grow(pool(), data(), method, start=drawn).value
    shape = on.models[0].validity
    assert isinstance(shape, Gaussians)
    kept = np.asarray(shape.centre)[:, 0]
    assert (0.25 in kept) != (0.75 in kept)
    record = data().records[0]
    low = record.u[:, 0] < 25
    part = records("tiny", record.u[low], record.y[low])
    start = grow(pool(), data(), Given(drawn, scheduling=("u1[t]",))).value
    moved = grow(pool(), part, method, start=start).stats["stages"][0][0]
    assert same_regions(start, moved)


def test_a_growth_goes_on_output_by_output():
    """From three regions of one output and four of the other."""
    whole = fitted("tiny", "gaussians", outputs=2)
    stages = [whole.stats["stages"][o][3 - 1 + o].models[0] for o in (0, 1)]
    both = dataclasses.replace(whole.value, models=tuple(stages))
    on = grow(pool(outputs=2), data(outputs=2), METHODS["gaussians"], start=both)
    for o in (0, 1):
        assert on.stats["models"][o].tolist() == [3, 4, 5][o:]
        assert same_regions(on.stats["stages"][o][0], both, o)


def test_a_start_that_does_not_fit_is_named():
    network = grown().value
    with pytest.raises(SpecError, match="more than max_models=2"):
        grow(pool(), data(), Lolimot(SCHEDULE, max_models=2), start=network)
    with pytest.raises(SpecError, match=r"the start is scheduled by u1\[t\], u2\[t\]"):
        grow(pool(), data(), Lolimot("u1[t]"), start=network)
    with pytest.raises(SpecError, match="the start has Gaussians"):
        grow(pool(), data(), METHODS["tree"], start=network)
    with pytest.raises(SpecError, match="the start has Gaussians"):
        grow(pool(), data(), METHODS["boxes"], start=network)
    with pytest.raises(SpecError, match="Global does not grow"):
        grow(pool(), data(), Global(), start=network)
