"""The map of the free-run error: every scored sample once, in its own cell."""

import dataclasses

import numpy as np
import pytest
from common import BRIEF, A, B, Part, from_rows, network

from jaxnarx.errors import SpecError
from jaxnarx.evaluation import report
from jaxnarx.evaluation._error_map import error_maps


def dataset():
    """y = a where b < 0 and a + 2 above; the network says a."""
    rng = np.random.default_rng(4)
    u = rng.uniform(-1, 1, (400, 2))
    y = np.stack([u[:, 0] + 2 * (u[:, 1] > 0), rng.normal(size=400)], axis=1)
    return from_rows([np.hstack([u, y])])


def test_the_error_lies_where_it_was_made():
    data = dataset()
    net = network([Part([[((0, 1), 0.0)]])])  # it says zero: the error is y itself
    found = report(net, data, **BRIEF)
    (one,) = found.maps
    # b tells most about y, then a: the shift by 2 against a spread of 0.6.
    assert one.variables == ("b[t]", "a[t]") and one.output == "y"
    row = found.pooled_row("y")
    assert one.samples.sum() == row.samples
    assert row.rmse is not None
    square = np.nansum(one.samples * one.rms**2) / row.samples
    assert square == pytest.approx(row.rmse**2, rel=1e-12)
    low, high = one.rms[:6], one.rms[6:]
    assert np.nanmean(low) < 0.7 and np.nanmin(high) > 0.9
    # 400 samples in 144 cells: every cell is thin; its bias is the mean of its errors
    assert one.thin.all()
    x, y = data.records[0].u[1:], data.records[0].y[1:, 0]  # one sample of history
    b, a = one.edges
    own = (x[:, 1] >= b[6]) & (x[:, 1] < b[7]) & (x[:, 0] >= a[2]) & (x[:, 0] < a[3])
    assert one.samples[6, 2] == own.sum() > 0
    assert one.bias[6, 2] == pytest.approx(y[own].mean(), rel=1e-12)
    assert one.spread[6, 2] == pytest.approx(y[own].std(), rel=1e-12)
    # It leads to the sample with its largest error.
    place = 1 + np.flatnonzero(own)[np.argmax(abs(y[own]))]
    assert one.places[6, 2].tolist() == [0, place]
    assert (one.places[one.samples == 0] == -1).all()
    assert one.usual == pytest.approx(row.rmse, rel=1e-12)
    assert one.worst is None and str(one) == ""  # thin cells say little
    many = dataclasses.replace(one, samples=100 * one.samples)
    i, j = many.worst or (-1, -1)
    assert one.rms[i, j] == np.nanmax(one.rms)
    assert str(many).startswith("y errs most at b[t] ") and " ppm, " in str(many)


def test_scheduling_variables_come_first_and_what_is_no_network_has_no_map():
    part = Part(
        [[((0, 1), 0.0)]] * 2,
        scheduling=((A, 0), (B, 1)),
        offset=(-1.0, -1.0),
        span=(2.0, 2.0),
        centre=[[0.2, 0.2], [0.8, 0.8]],
        width=[[0.3, 0.3]] * 2,
    )
    found = report(network([part]), dataset(), **BRIEF)
    assert found.maps[0].variables == ("a[t]", "b[t-1]")
    for over in (("b", "w"), ("b[t-3]", "a")):
        told = report(network([part]), dataset(), over=over, **BRIEF).maps[0].variables
        assert [t.removesuffix("[t]") for t in told] == list(over)
    with pytest.raises(SpecError, match=r"unknown|no channel|c\[t\]"):
        report(network([part]), dataset(), over=("b", "c"), **BRIEF)
    with pytest.raises(SpecError, match="over must name two channels"):
        report(network([part]), dataset(), over=("b",), **BRIEF)
    assert error_maps(object(), dataset(), []) == ()
