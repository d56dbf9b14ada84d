"""The network of nested regions runs freely as its columns do."""

import nested_problems as problems
import numpy as np
import pytest
from nested_problems import B_INPUT, LONGEST, OUTPUT, coefficients, leaves, nested

import jaxnarx as jnx
from jaxnarx.partition.closed_form.network import make_network

ROUNDING = 1e-9
"""Of a standard deviation. Inputs are 500 of their own from zero: a square loses six
digits of sixteen in the terms of a network."""


def compared(design, regions, theta):
    """Network, its run's largest distance from the columns' run, and the runs' span."""
    data, made = problems.records(), design.signals
    network = make_network(design, regions, theta, data)
    run = jnx.simulate(network, data).value
    assert not sum(int(at.sum()) for at in run.limited), "the bound holds the run"
    runs = design.runs(theta)
    away, gain = 0.0, made.gain[OUTPUT]
    for record, y, own in zip(data, run.outputs, runs, strict=True):
        assert len(record) - len(own) == network.history
        own = (own * made.spread + made.middle) * gain
        away = max(away, float(np.abs(own - y[-len(own) :, 0]).max()))
    return network, away / (made.spread * gain), np.std(np.concatenate(runs))


@pytest.fixture(scope="module")
def several():
    found = nested()
    regions = tuple(leaf.region for leaf in leaves())
    return compared(found, regions, coefficients(found))


def test_free_run_of_several_regions(several):
    network, away, span = several
    assert network.history == LONGEST and span > 0.2
    assert network.models[0].active.shape == (5,)
    assert away < ROUNDING


def test_free_run_of_one_region():
    found = nested(1)
    network, away, span = compared(found, ((),), coefficients(found, 0.15))
    assert len(network.models[0].active) == 1 and span > 0.2
    assert away < ROUNDING


def test_all_regions_share_the_feedback(several):
    network, *_ = several
    local = network.models[0].local
    table = np.asarray(local.dense())
    names = [
        jnx.regressors.term_name(network.variable_names, row)
        for row in np.asarray(local.factor).tolist()
    ]
    for lag, value in enumerate(-problems.FEEDBACK[1:], 1):
        at = names.index(f"y[t-{lag}]")
        np.testing.assert_allclose(table[:, at], value, rtol=1e-15)


def test_order_of_the_leaves_does_not_matter(several):
    """Leaves are stored by order of growth; the run is that of the set."""
    found = nested()
    regions = tuple(leaf.region for leaf in leaves())[::-1]
    _, away, _ = compared(found, regions, coefficients(found))
    assert away < ROUNDING


def test_what_no_column_needs_is_not_computed():
    """Variables without a term go, and a network without feedback has none."""
    found = nested(1).move(np.ones(1))
    theta = np.zeros(found.equations.columns)
    factor = found.signals.factor.tolist()
    theta[factor.index([0, 3])] = 0.4
    network = make_network(found, ((),), theta, problems.records())
    assert network.variable_names == ["b[t-2]"] and network.history == 2
    run = jnx.simulate(network, problems.records()).value
    made = found.signals
    shift, spread = (a[3] for a in (made.centring.shift, made.centring.spread))
    for record, y in zip(problems.records(), run.outputs, strict=True):
        z = (record.u[:-2, B_INPUT] / made.gain[B_INPUT] - shift) / spread
        expected = (0.4 * made.spread * z + made.middle) * made.gain[OUTPUT]
        np.testing.assert_allclose(y[2:, 0], expected, rtol=1e-12)


def test_nothing_but_the_mean():
    found = nested(1).move(np.ones(1))
    theta = np.zeros(found.equations.columns)
    network = make_network(found, ((),), theta, problems.records())
    run = jnx.simulate(network, problems.records()).value
    middle = found.signals.middle * found.signals.gain[OUTPUT]
    for y in run.outputs:
        np.testing.assert_allclose(y, middle, rtol=1e-14)
