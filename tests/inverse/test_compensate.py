"""Training through the forward network: exact derivatives, better tracking, a guard."""

import dataclasses
import operator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from inverse_problems import plant, recorded

from jaxnarx.arrays import evaluate_at
from jaxnarx.arrays.programs import strip_names
from jaxnarx.errors import SpecError
from jaxnarx.inverse import cascade, compensate
from jaxnarx.inverse.loop import connect
from jaxnarx.inverse.task import make_task, spreads
from jaxnarx.inverse.tracking_problem import _residuals, tracking_problem
from jaxnarx.refinement.layout import make_layout
from jaxnarx.settings.inverse import ActuatorLimits, TrackingError

LIMITS = ActuatorLimits(range={"u": (-0.7, 0.8)}, rate={"u": 6.0})


@pytest.fixture(scope="module")
def case(inverse, forward, clean):
    """The inverse, the forward network, references and others that nobody has seen."""
    return inverse, forward, clean, recorded(plant, seed=7)


@pytest.fixture(scope="module")
def problem(case):
    inverse, forward, clean, _ = case
    loop = connect(inverse, forward, LIMITS)
    layout = make_layout(inverse, None, (0.5, 2.0))
    task = make_task(loop, clean)
    spread = spreads(loop, task)
    return strip_names(tracking_problem(loop, layout, task, spread, 0.01)), layout


def test_the_gradient_equals_central_differences(problem):
    found, layout = problem
    u = np.asarray(layout.gather(layout.base))
    linear, loss = evaluate_at(found.linear, u), partial(evaluate_at, found.loss)
    step = 1e-6
    for n in range(len(u)):
        move = step * np.eye(len(u))[n]
        # Away from the samples at which a limit sets in or ends, the loss is smooth.
        slope = (loss(u + move) - loss(u - move)) / (2 * step)
        # Rounding 1e-16 / 1e-6, and the third derivative times 1e-12.
        gradient = 2 * float(linear.gradient[n])
        assert gradient == pytest.approx(float(slope), rel=1e-5, abs=1e-8)


@pytest.mark.slow
def test_the_normal_equations_are_those_of_the_residuals(problem):
    found, layout = problem
    u = np.asarray(layout.gather(layout.base))
    linear = evaluate_at(found.linear, u)
    gram, gradient, loss = 0.0, 0.0, 0.0

    def residuals(p, record):
        parts = _residuals(found.loop, layout, p, record)
        return jnp.concatenate(parts)

    # Reverse mode here, forward mode there.
    both = jax.jit(lambda p, r: (residuals(p, r), jax.jacrev(residuals)(p, r)))
    for n in range(2):
        record = jax.tree.map(operator.itemgetter(n), found.data)
        r, jacobian = both(jnp.asarray(u), record)
        gram, gradient = gram + jacobian.T @ jacobian, gradient + r @ jacobian
        loss = loss + float(r @ r)
    np.testing.assert_allclose(linear.gram, gram, atol=1e-10)
    np.testing.assert_allclose(linear.gradient, gradient, atol=1e-10)
    assert float(linear.loss) == pytest.approx(loss)


@pytest.fixture(scope="module")
def trained(case):
    inverse, forward, clean, _ = case
    rows = []
    method = TrackingError(effort=0.0, max_steps=8)
    return compensate(inverse, forward, clean, method, progress=rows.append), rows


def test_tracks_unseen_references_a_third_better(case, trained):
    inverse, forward, _, unseen = case
    direct = cascade(inverse, forward, unseen).stats["nrmse"][0]
    refined = cascade(trained[0].value, forward, unseen).stats["nrmse"][0]
    assert refined < 0.7 * direct


def test_progress_tells_what_the_history_holds(trained):
    solution, rows = trained
    assert solution.is_okay
    assert rows == solution.stats["history"] and rows
    assert solution.stats["loss"] == min(row["validation"] for row in rows)
    assert solution.stats["loss"] < solution.stats["loss_start"]


def test_never_worse_than_the_direct_inverse_where_it_is_judged(case):
    inverse, forward, clean, _ = case
    # Trained near the upper end alone, where the curve is another; judged everywhere.
    records = tuple(dataclasses.replace(r, y=1.0 + 0.1 * r.y) for r in clean)
    elsewhere = dataclasses.replace(clean, records=records)
    method = TrackingError(effort=0.0, max_steps=3)
    found = compensate(inverse, forward, elsewhere, method, validation=clean)
    assert found.stats["history"][-1]["validation"] > found.stats["loss_start"]
    direct, kept = (
        cascade(net, forward, clean).stats["nrmse"][0] for net in (inverse, found.value)
    )
    assert kept <= direct


@pytest.mark.slow
def test_effort_calms_the_commands(case, trained):
    inverse, forward, clean, _ = case
    method = TrackingError(effort=3.0, max_steps=8)
    calm = compensate(inverse, forward, clean, method).value

    def moved(net):
        found = cascade(net, forward, clean).value
        return sum(np.sum(np.diff(u[2:, 0]) ** 2) for u in found.commands)

    assert moved(calm) < 0.8 * moved(trained[0].value)


@pytest.mark.slow
def test_windows_come_before_whole_records(case):
    inverse, forward, clean, _ = case
    method = TrackingError(effort=0.0, horizons=(10,), window_steps=2, max_steps=2)
    found = compensate(inverse, forward, clean, method)
    assert [row["horizon"] for row in found.stats["history"]] == [10, 10, None, None]
    assert found.stats["loss"] < found.stats["loss_start"]


def test_without_steps_the_start_comes_back(case):
    inverse, forward, clean, _ = case
    solution = compensate(inverse, forward, clean, TrackingError(max_steps=0))
    assert solution.value is inverse
    assert solution.stats["loss"] == solution.stats["loss_start"]


def test_settings_are_checked():
    for make in (
        lambda: TrackingError(effort=-1.0),
        lambda: TrackingError(horizons=(0,)),
        lambda: TrackingError(width_band=(2.0, 3.0)),
        lambda: TrackingError(patience=-1),
    ):
        with pytest.raises(SpecError):
            make()
