"""The error of a free run by the index of the domain, in the report."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.data import Channel, Dataset
from jaxnarx.evaluation.domain_errors import (
    BORDER_EDGE,
    INDEX_EDGES,
    ErrorByIndex,
    _bin_errors,
)

NOX = Channel("NOx", "ppm")


def test_errors_are_told_by_the_index_of_their_sample():
    rng = np.random.default_rng(0)
    index = rng.uniform(0, 4, 5000)
    error = np.where(index > 1, 3.0, 0.5) * rng.choice([-1.0, 1.0], 5000)
    found = _bin_errors(NOX, error, index)
    assert found.samples.sum() == 5000
    assert found.inside == pytest.approx(0.5) and found.outside == pytest.approx(3.0)
    for k, (low, high) in enumerate(
        zip(INDEX_EDGES[:-1], INDEX_EDGES[1:], strict=True)
    ):
        own = (index > low) & (index <= high)
        assert found.samples[k] == own.sum()
        if own.any():
            assert found.rms[k] == pytest.approx(0.5 if k < BORDER_EDGE else 3.0)


def test_of_few_samples_nothing_is_told():
    found = _bin_errors(NOX, np.ones(30), np.r_[np.full(25, 0.4), np.full(5, 2.5)])
    assert found.inside == pytest.approx(1.0) and found.outside is None
    assert np.isnan(found.rms[INDEX_EDGES.index(2.0)])
    nothing = ErrorByIndex("y", "", np.zeros(3), np.zeros(3, int))
    assert nothing.inside is None


@pytest.fixture(scope="module")
def data() -> Dataset:
    """y = .8 y(t-1) + u^2, two records; in the second the input goes farther."""
    rng = np.random.default_rng(1)
    us, ys = [], []
    for reach in (1.0, 3.0):
        u = np.repeat(rng.uniform(-reach, reach, 40), 8)[:, None]
        y = np.zeros_like(u)
        for t in range(1, len(y)):
            y[t] = 0.8 * y[t - 1] + abs(u[t - 1]) ** 1.5
        us.append(u)
        ys.append(y)
    return Dataset.from_arrays(us, ys, inputs=["u"], outputs=["y"], sample_time=0.1)


def test_a_report_says_how_often_and_how_much(data, tmp_path):
    train, test = data[:1], data[1:]
    pool = jnx.polynomial_pool(data.channels, input_lags=[1], output_lags=[1], degree=2)
    terms = jnx.select(pool, train, jnx.ForwardOLS(max_terms=3)).value
    net = jnx.grow(terms, train, jnx.Global()).value
    parts = {"train": train, "test": test}
    plain: dict[str, Any] = {"stability": False, "diagnostics": False}
    assert jnx.report(net, parts, **plain).domain is None
    net = jnx.confidence.fit_domain(net, train)
    # the truth leaves the trained range: that is no divergence here
    net = dataclasses.replace(net, lower=net.lower - 50, upper=net.upper + 50)
    found = jnx.report(net, parts, **plain)
    assert found.domain is not None and found.domain.outside["test"] > 0.3
    (error,) = found.domain.errors
    assert error.output == "y"
    assert error.outside is not None and error.inside is not None
    assert error.outside > 2 * error.inside
    assert found.domain.excursions[0].channel == "u"
    (note,) = [n for n in found.notes if "test samples are outside of the domain" in n]
    assert "free-run error: y" in note and "farthest:" in note
    # the truth bends where the domain ends: the worst stretches are there, and say so
    worst = found.worst[0]
    assert (worst.output, worst.record) == ("y", test.records[0].name)
    assert worst.times > 1.5 and worst.index is not None and worst.index > 1
    assert "of u" in worst.unusual and "times the usual" in str(worst)
    assert len(found.worst) <= 10
    errors = [one.rmse for one in found.worst]
    assert errors[0] == max(errors)
    assert found.to_dict()["domain"]["outside"]["test"] == found.domain.outside["test"]
    found.to_html(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "What the model knows" in page and "The farthest stretches outside" in page
