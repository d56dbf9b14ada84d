"""The verb `identify` is the verbs in a row, by one tree of settings."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest
from identify_problems import SMALL, engine, parts

from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.identification import identify
from jaxnarx.models import Gaussians
from jaxnarx.partition import grow
from jaxnarx.refinement import refine
from jaxnarx.regressors import LowPass, polynomial_pool
from jaxnarx.selection import select
from jaxnarx.settings import Identification, Polynomial
from jaxnarx.settings.tree import replace_at


@pytest.fixture(scope="module")
def data() -> Dataset:
    return engine(1)


def test_the_verbs_in_a_row(data):
    train, validation, _ = parts(data)
    rows: list[dict[str, Any]] = []
    fit = identify(train, SMALL, validation=validation, progress=rows.append)
    pool = polynomial_pool(
        data.channels, input_lags=(0, 1), output_lags=(1, 2), degree=2
    )
    chosen = select(pool, train, SMALL.select)
    grown = grow(chosen.value, train, SMALL.grow, validation=validation)
    refined = refine(grown.value, train, SMALL.refine, validation=validation)
    assert fit.stats["selection"].value.names == chosen.value.names
    for ours, theirs in (
        (fit.stats["grown"].value, grown.value),
        (fit.value, refined.value),
    ):
        np.testing.assert_array_equal(
            np.asarray(ours.models[0].local.coefficient),
            np.asarray(theirs.models[0].local.coefficient),
        )
    assert fit.status_name == refined.status_name and fit.detail == refined.detail
    # Every verb tells its end, and the refinement every step.
    ended = [row["verb"] for row in rows if "solution" in row]
    assert ended == ["select", "grow", "refine"]
    assert rows[0] == {"verb": "select", "candidates": len(pool)}
    assert sum("loss" in row for row in rows) == len(refined.stats["history"])


def test_without_refinement_the_grown_network_is_the_result(data):
    fit = identify(data[0], dataclasses.replace(SMALL, refine=None))
    grown = fit.stats["grown"].value
    assert fit.stats["refined"] is None and fit.value.domain is not None
    # but for what it knows of its training nothing of it has changed
    bare = dataclasses.replace(fit.value, domain=None, certificate=None)
    pairs = zip(jax.tree.leaves(bare), jax.tree.leaves(grown), strict=True)
    assert all(a is b for a, b in pairs)


@pytest.mark.parametrize(
    ("train", "still"), [("coefficients", "centre"), ("partition", "coefficient")]
)
def test_one_kind_alone_is_trained(data, train, still):
    method = replace_at(SMALL, {"refine.train": train})
    fit = identify(data[0], method)
    start, end = (n.models[0] for n in (fit.stats["grown"].value, fit.value))
    assert isinstance(start.validity, Gaussians) and isinstance(end.validity, Gaussians)
    values = {
        "centre": (start.validity.centre, end.validity.centre),
        "coefficient": (start.local.coefficient, end.local.coefficient),
    }
    for name, (before, after) in values.items():
        assert np.array_equal(before, after) == (name == still), name


def test_outputs_that_nothing_asks_for_are_left_out():
    rng = np.random.default_rng(0)
    u, noise = rng.normal(size=(80, 1)), 0.01 * rng.normal(size=(80, 3))
    data = Dataset.from_arrays(
        u,
        u * [[1.0, 2.0, 3.0]] + noise,
        inputs=["u"],
        outputs=["y", "w", "v"],
        sample_time=1.0,
    )
    method = replace_at(
        Identification(),
        {
            "pool": Polynomial(outputs="y", input_lags=(0,), output_lags=(), degree=1),
            "grow": {"method": "lolimot", "scheduling": ["w[t-1]"], "max_models": 1},
            "refine": "none",
        },
    )
    assert identify(data, method).value.channels.output_names == ["y", "w"]


def test_time_constants_are_filters(data):
    method = Identification(
        pool=Polynomial(input_lags=(), output_lags=(), filters=(1, LowPass(2.0))),
        refine=None,
    )
    names = identify(data[0], method).stats["selection"].value.pool.variable_names
    assert names[:2] == ["lp(a, 1 s)[t]", "lp(a, 2 s)[t]"]


def test_a_wrong_name_is_told_before_any_work(data):
    method = replace_at(SMALL, {"pool.outputs": ["z"]})
    with pytest.raises(SpecError, match="unknown output 'z'"):
        identify(data[0], method)
