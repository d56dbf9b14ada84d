"""Sums of an engine's run against derivatives of the run itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fleet_problems import donors, structure

import jaxnarx as jnx
from jaxnarx.fleet.coefficients import choose_coefficients, names_of, offset_and_gain
from jaxnarx.fleet.information import gather_information, parts_of, skip_begin


@pytest.mark.parametrize("fed", [False, True])
def test_sums_are_those_of_the_jacobian_of_the_free_run(fed):
    network = structure(fed)
    data = donors(fed=0.5 if fed else 0.0)["engine 3"]
    own = choose_coefficients(network, gates=False, feedback=True)
    runs = jnx.prepare(network, data)
    v = jnp.asarray(np.linspace(-0.02, 0.03, len(own.free)))
    part = jax.device_put(parts_of(runs, (20, 60)))
    found = gather_information(own, v, runs, part, 3)

    def run(v):
        return jnx.free_run(own.place(v), runs)[0, :, 0] / network.gain[-1]

    y, jacobian = np.asarray(run(v)), np.asarray(jax.jacfwd(run)(v))
    measured = np.asarray(runs.measured)[0, :, 0] / float(network.gain[-1])
    at = np.flatnonzero(np.asarray(runs.scored)[0, :, 0])
    for p, rows in enumerate((at[:20], at[20:60], at[60:])):
        r, j = (y - measured)[rows], jacobian[rows]
        np.testing.assert_allclose(found.square[p, 0], r @ r, rtol=1e-10)
        np.testing.assert_allclose(found.right[p, 0], j.T @ r, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(found.gram[p, 0], j.T @ j, rtol=1e-8, atol=1e-10)
        assert int(found.samples[p, 0]) == len(rows)


def test_a_run_without_feedback_is_quadratic_in_its_coefficients():
    network = structure()
    own = choose_coefficients(network, gates=False, feedback=False)
    runs = jnx.prepare(network, donors()["engine 3"])
    part = jax.device_put(parts_of(runs, ()))
    zero, far = np.zeros(len(own.free)), np.array([0.3, -0.5, 0.2, 0.4])
    there = gather_information(own, far, runs, part, 1)
    about = gather_information(own, zero, runs, part, 1).total()
    np.testing.assert_allclose(about.loss(far), there.square[0], rtol=1e-10)


def test_feedback_keeps_its_coefficients_unless_asked():
    network = structure(fed=True)
    every = choose_coefficients(network, gates=False, feedback=True)
    own = choose_coefficients(network, gates=False, feedback=False)
    gone = set(names_of(every)) - set(names_of(own))
    assert {name.split(": ")[-1] for name in gone} == {"y[t-1]"}


@pytest.mark.parametrize("fed", [False, True])
def test_offset_and_gain_move_the_free_run_so(fed):
    """At rest behind linear feedback: by the offset over what is not fed back."""
    network = structure(fed)
    runs = jnx.prepare(network, donors(fed=0.5 if fed else 0.0)["engine 0"])
    own = choose_coefficients(network, gates=False, feedback=fed)
    offset, gain = offset_and_gain(own).T
    y = np.asarray(jnx.free_run(network, runs))[0, 100:190, 0]
    taller = np.asarray(jnx.free_run(own.place(jnp.asarray(gain)), runs))
    np.testing.assert_allclose(taller[0, 100:190, 0], 2 * y, rtol=1e-6)
    higher = np.asarray(jnx.free_run(own.place(jnp.asarray(offset)), runs))
    moved = higher[0, 100:190, 0] - y
    np.testing.assert_allclose(moved, moved[0], rtol=1e-6)
    assert moved[0] > 0


def test_first_samples_are_left_out_where_others_are_left():
    runs = jnx.prepare(structure(), donors()["engine 0"])
    counted = np.asarray(runs.scored).sum()
    assert np.asarray(skip_begin(runs, 50).scored).sum() == counted - 48
    assert np.asarray(skip_begin(runs, 198).scored).sum() == counted
