"""Sizes of errors, against sorting them."""

import common
import numpy as np
import pytest
from test_effect_sizes import OUTPUT, samples
from test_verdict import FINE, made

import jaxnarx as jnx
from jaxnarx.errors import SpecError
from jaxnarx.evaluation.error_distribution import error_distribution
from jaxnarx.shell.report.html import render


def test_the_curve_is_that_of_sorted_errors_of_bounded_records():
    free = [samples(1.0), samples(-3.0, "r2", count=28), samples(9, diverged=True)]
    found = error_distribution(OUTPUT, free, 2.0)
    assert found is not None
    # 9 samples of 1 and 27 of 3.
    assert found.samples == 36 and found.largest == found.most == 3.0
    assert found.within == 0.25 and np.all(np.diff(found.size) >= 0)
    without = error_distribution(OUTPUT, free, None)
    assert without is not None and without.within is None
    assert error_distribution(OUTPUT, [samples(1.0, diverged=True)], 1.0) is None
    one = error_distribution(OUTPUT, [samples(2.0, count=2)], None)
    assert one is not None
    assert (one.samples, one.largest, one.most) == (1, 2.0, 2.0)


def test_a_report_tells_them_and_draws_the_curve():
    net, data = common.named("one model"), common.dataset((60, 45))
    found = jnx.report(net, data, within=4, **common.BRIEF)
    (one,) = found.distributions
    run = jnx.simulate(net, data).value
    parts = zip(data, run.outputs, run.scored, strict=True)
    error = np.concatenate([np.abs(r.y[:, :1] - y)[s] for r, y, s in parts])
    assert one.largest == error.max() and one.within == np.mean(error <= 4)
    assert one.most == pytest.approx(np.quantile(error, 0.95), rel=0.02)
    section = found.findings["errors"]
    assert str(section) in found.table and "data data" not in found.table
    (row,) = section.rows
    assert row[1:] == (one.samples, one.most, one.largest, 100 * np.mean(error <= 4))
    page = render(found)
    assert "within 4" in page and "How large the errors are" in page
    assert "data data" not in page
    assert found.to_dict()["distributions"][0]["within"] == one.within
    with pytest.raises(SpecError, match="within"):
        jnx.report(net, data, within=-1.0, **common.BRIEF)
    assert "How large" not in render(made(*FINE))
