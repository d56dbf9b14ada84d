"""Operating points at rest among the rows of the closed form, beside held records."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from jaxnarx.data import Dataset, groups, join
from jaxnarx.partition import ClosedSearch, profile_data, rest_points
from jaxnarx.partition.closed_form.design_matrix import BlockDesign, Gate
from jaxnarx.partition.closed_form.gauss_newton import derivatives, shift_gates
from jaxnarx.partition.closed_form.growth import Box, choose_size
from jaxnarx.partition.closed_form.rest import MOST_WEIGHT, RestPoints, _deal
from jaxnarx.simulation import simulate

A = np.array([1.0, -1.5, 0.56])
GATE = Gate(0, 0.45, 9.0)


def static(u):
    return np.tanh(1.5 * u[:, 0]) + 0.6 * u[:, 0] * u[:, 1] + 0.5 * u[:, 1] ** 2


def response(u):
    """First order, to a bent map of two inputs."""
    return lfilter([0.0, 0.3], [1, -0.7], static(u))


def made(us, ys):
    ys = [y[:, None] for y in ys]
    named = {"inputs": ["a", "b"], "outputs": ["y"], "sample_time": 0.1}
    return Dataset.from_arrays(us, ys, **named)


def steps(rng, rows):
    return np.repeat(rng.uniform(-1, 1, (rows // 9 + 1, 2)), 9, axis=0)[:rows]


@pytest.fixture(scope="module")
def data():
    """Inputs that move together."""
    rng = np.random.default_rng(0)
    us = [steps(rng, 170) @ np.array([[1.0, 0.9], [0.0, 0.05]]) for _ in range(4)]
    return made(us, [response(u) + 0.05 * rng.normal(size=len(u)) for u in us])


@pytest.fixture(scope="module")
def points():
    """Inputs that do not, with one output missing."""
    rng = np.random.default_rng(1)
    u = rng.uniform(-1, 1, (25, 2))
    found = made([u], [static(u)])
    valid = found.records[0].valid.copy()
    valid[7, 2] = False
    record = dataclasses.replace(found.records[0], valid=valid)
    return dataclasses.replace(found, records=(record,))


def search_of(data, points, root=False):
    seen = profile_data(data, "y")
    own = data, seen, groups(data, gap=seen.memory)
    return ClosedSearch(*own, root=root, at_rest=points)


@pytest.fixture(scope="module")
def search(data, points):
    return search_of(data, points)


@pytest.fixture(scope="module")
def design(search):
    made = BlockDesign.of(search.signals(search.memory(1), 2), A)
    return made.extend(made.block(())).extend(made.block((GATE,)))


def test_rows_at_rest_are_the_end_of_held_records(data, points):
    known = rest_points(points, "y")
    assert known is not None and len(known.output) == 24
    held = made([np.tile(u, (900, 1)) for u in known.inputs[:3]], [np.zeros(900)] * 3)
    search = search_of(join([data, held]), points)
    *_, one, two, three, rest = search.signals(search.memory(1), 2).stretches
    for n, same in enumerate((one, two, three)):
        np.testing.assert_allclose(rest.z[:, n], same.z[:, -1], atol=1e-8)
        np.testing.assert_allclose(rest.x[:, n], same.x[:, -1], atol=1e-8)
        columns = np.ones((1, len(same.y)))
        settled = same.filter_columns(columns, A)[:, -1]
        np.testing.assert_allclose(rest.filter_columns(columns, A)[:, 0], settled)
    assert rest.at_rest and not one.at_rest


def test_points_are_held_out_with_the_groups_in_turns(data, search, design):
    signals, equations = design.signals, design.equations
    groups = len(search.groups)
    assert signals.apart.shape == (groups, len(equations))
    counted, points = equations.samples[:-groups].sum(), equations.samples[-groups:]
    times = points.sum() / 24
    assert 24 * times <= MOST_WEIGHT * counted < 24 * (times + 1)
    assert times == int(times) <= search.profile.memory
    for g in range(groups):
        part = signals.rest_part(g)
        assert np.flatnonzero(signals.apart[:, part]).tolist() == [g]
        assert equations.samples[part] == times * len(range(g, 24, groups))
    bare = search_of(data, None)
    plain = BlockDesign.of(bare.signals(bare.memory(1), 2), A)
    plain = plain.extend(plain.block(())).extend(plain.block((GATE,)))
    for name in ("gram", "right", "square", "samples"):
        found, known = (getattr(d.equations, name) for d in (design, plain))
        np.testing.assert_allclose(found[:-groups], known)
    np.testing.assert_array_equal(equations.judged, plain.equations.judged)
    np.testing.assert_array_equal(design.places(0), plain.places(0))
    assert plain.signals.rest_part(0) is None


def test_no_group_holds_a_row_of_a_map():
    """Points in the order of a map, whose rows are as many as the groups."""
    grid = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=2).reshape(-1, 2)
    points = RestPoints(grid, grid.sum(axis=1))
    dealt = _deal(points, 5)
    assert np.bincount(dealt).tolist() == [6] * 5
    for g in range(5):
        assert len(set(grid[dealt == g, 0])) > 1 < len(set(grid[dealt == g, 1]))
    turned = np.random.default_rng(3).permutation(30)
    again = _deal(RestPoints(grid[turned], points.output[turned]), 5)
    np.testing.assert_array_equal(again, dealt[turned])


def test_what_is_held_out_is_judged_apart(design):
    """Records by the error that is told; both by the score that chooses."""
    losses, points = design.held_out_losses(1e-3)
    for g in range(len(losses)):
        theta = design.equations.exclude_group(g).solve(1e-3)
        rest = design.signals.stretches[-1]
        at = rest.counted[design.signals.rest_part(g)]
        error = design.runs(theta)[-1][at] - rest.y[at]
        np.testing.assert_allclose(points[g], error @ error, rtol=1e-6)
    leaf = Box((), np.zeros(2), np.ones(2))
    stage = choose_size(design, (leaf,))
    own = design.equations
    assert stage.error == pytest.approx(
        np.sqrt(stage.losses.sum() / own.judged.sum()), rel=1e-12
    )
    every = stage.losses.sum() + stage.rest_loss
    count = own.judged.sum() + own.samples[-len(losses) :].sum()
    assert stage.score == pytest.approx(np.sqrt(every / count), rel=1e-12)
    assert stage.rest_loss > 0


def test_derivatives_at_rest_are_central_differences(design):
    theta = np.random.default_rng(2).normal(size=design.equations.columns)
    place = ((), GATE)
    found = np.zeros((4, len(design.signals.stretches[-1].y)))
    counted = design.signals.stretches[-1].counted
    parts = zip(derivatives(design, theta, [place]), counted, strict=True)
    for rows, at in parts:
        if len(at):
            found[:, at] = rows

    def at_rest(a, move):
        own = design.move(a, shift_gates([place], move))
        return own.runs(theta)[-1]

    h = 1e-5
    for row, step in zip(found, np.eye(4) * h, strict=True):
        sides = (at_rest(A + s * np.r_[0, step[:2]], s * step[2:]) for s in (1, -1))
        up, down = sides
        np.testing.assert_allclose(row, (up - down) / (2 * h), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("root", [False, True])
def test_what_records_do_not_tell_points_do(data, points, root):
    rng = np.random.default_rng(5)
    u = steps(rng, 600)
    errors = []
    for known in (None, points):
        search = search_of(data, known, root)
        forms = list(search.candidates(3, grown_roots=1))
        best = min(forms, key=lambda one: one.free_run)
        network = best.network()
        run = simulate(network, made([u], [response(u)]))
        errors.append(np.std(run.value.outputs[0][50:, 0] - response(u)[50:]))
    assert errors[1] < 0.6 * errors[0]


def test_an_output_without_points_is_as_without_any(data, points):
    valid = points.records[0].valid.copy()
    valid[:, 2] = False
    record = dataclasses.replace(points.records[0], valid=valid)
    nothing = dataclasses.replace(points, records=(record,))
    assert rest_points(nothing, "y") is None
    found = search_of(data, nothing).signals(search_of(data, None).memory(1), 1)
    assert not any(one.at_rest for one in found.stretches)
