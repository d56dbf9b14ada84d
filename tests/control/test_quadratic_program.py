"""Quadratic programs against a general solver, and their conditions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from jaxnarx.control.quadratic_program import TOLERANCE, solve_quadratic


def program(seed, n=6, limits=14):
    random = np.random.default_rng(seed)
    a = random.normal(size=(n, n))
    rows, bound = random.normal(size=(limits, n)), random.uniform(0.1, 1.0, limits)
    return a @ a.T + 0.1 * np.eye(n), 5 * random.normal(size=n), rows, bound


def solve(h, g, rows, bound):
    given = [jnp.asarray(a) for a in (h, g, rows, bound)]
    return solve_quadratic(*given, jnp.zeros(len(g)))  # pyright: ignore


@pytest.mark.parametrize("seed", range(3))
def test_it_agrees_with_a_general_solver(seed):
    h, g, rows, bound = program(seed)
    found = solve(h, g, rows, bound)
    oracle = minimize(
        lambda z: 0.5 * z @ h @ z + g @ z,
        np.zeros(6),
        jac=lambda z: h @ z + g,
        constraints={"type": "ineq", "fun": lambda z: bound - rows @ z},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert float(found.residual) < TOLERANCE
    np.testing.assert_allclose(found.z, oracle.x, atol=1e-6)


def test_at_the_solution_all_conditions_hold():
    h, g, rows, bound = program(7)
    found = solve(h, g, rows, bound)
    z, multipliers = np.asarray(found.z), np.asarray(found.multipliers)
    slack = bound - rows @ z
    assert np.abs(h @ z + g + rows.T @ multipliers).max() < 1e-8
    assert slack.min() > -1e-8 and multipliers.min() >= 0
    assert np.abs(slack * multipliers).max() < 1e-8
    assert (multipliers > 1e-3).any()  # some limits act


def test_no_limit_acts_and_limits_may_be_infinite():
    h, g, rows, bound = program(3)
    bound = np.full_like(bound, np.inf)
    found = solve(h, g, rows, bound)
    np.testing.assert_allclose(found.z, np.linalg.solve(h, -g), atol=1e-7)


def test_limits_that_contradict_each_other_leave_a_residual():
    h, g = np.eye(1), np.zeros(1)
    rows, bound = np.array([[1.0], [-1.0]]), np.array([-1.0, -1.0])
    found = solve(h, g, rows, bound)
    assert not float(found.residual) < 1e-3


def test_many_at_once():
    every = [program(seed) for seed in range(4)]
    stacked = [np.stack(part) for part in zip(*every, strict=True)]
    found = jax.vmap(lambda *p: solve(*p).z)(*stacked)
    for z, one in zip(found, every, strict=True):
        alone = solve(*one).z
        np.testing.assert_allclose(z, alone, atol=1e-7)
