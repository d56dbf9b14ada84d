"""Models side by side and errors by size, against reports and plain selections."""

from functools import cache
from typing import Any

import common
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import compare, errors_by_size

data = cache(lambda: common.dataset((150, 150)))


@cache
def chosen() -> jnx.Selection:
    lags: dict[str, Any] = {"input_lags": (0, 1), "output_lags": (1,), "degree": 2}
    pool = jnx.polynomial_pool(data().channels, **lags)
    return jnx.select(pool, data()[0], jnx.ForwardOLS(max_terms=4)).value


def test_models_and_parts_have_the_figures_of_their_reports():
    models = {
        "one": common.named("coupled"),
        "two": common.named("coupled, by own output"),
    }
    parts = {"train": data()[0], "test": data()[1]}
    found = compare(models, parts, output="w")
    for name, network in models.items():
        told = jnx.report(network, parts, **common.BRIEF)
        for part in parts:
            row = told.pooled_row("w", part=part)
            assert found.pooled[name][part].nrmse == row.nrmse
    assert found.parts == ["train", "test"] and len(found.records) == 2
    worst = found.worst("test")
    run = jnx.simulate(models["one"], parts["test"]).value
    np.testing.assert_array_equal(worst.simulated["one"], run.outputs[0][:, 1])
    assert np.isnan(worst.measured[:2]).all()  # its history is not scored
    assert "train" in str(found).splitlines()[0]


def test_a_model_that_diverges_is_told_and_comes_first():
    tight = common.named("coupled", bound=1e-3)
    found = compare({"tight": tight, "free": common.named("coupled")}, data())
    assert found.worst("data").fit["tight"] is None
    assert "diverged (2 of 2)" in str(found)


def test_a_comparison_needs_something_in_common():
    with pytest.raises(SpecError, match="no output 'z'"):
        compare(common.named("coupled"), data(), output="z")
    with pytest.raises(SpecError, match="'one' has no output 'w'"):
        compare(
            {"two": common.named("coupled"), "one": common.named("one model")},
            data(),
            output="w",
        )
    with pytest.raises(SpecError, match="nothing to compare"):
        compare({}, data())


def test_errors_by_size_are_those_of_smaller_selections():
    parts = {"train": data()[0], "test": data()[1]}
    found = errors_by_size(chosen(), parts)
    for size in (2, 4):
        alone = jnx.grow(chosen().head(size), data()[0], jnx.Global()).value
        told = jnx.report(alone, parts, **common.BRIEF)
        for one in found:
            for part in parts:
                row = told.pooled_row(one.output.name, part=part)
                # One least-squares problem, solved in two ways.
                assert one.free_run[part][size - 1] == pytest.approx(
                    row.nrmse, rel=1e-6
                )


def test_one_step_errors_are_what_the_selection_leaves():
    selection = chosen()
    for o, one in enumerate(errors_by_size(selection, data()[0])):
        expected = np.sqrt(selection.sse[o] / selection.total[o])
        np.testing.assert_allclose(one.one_step["data"], expected, rtol=1e-6)
        assert one.chosen == 4 and one.best("data") in one.sizes
        assert np.all(np.diff(one.operations) >= 0)
        assert "4 *" in str(one)
