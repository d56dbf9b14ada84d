"""Bad input to every selector: a named status or error, the terms found, never NaN."""

import common
import numpy as np
import pytest
from common import A, B, Y
from test_select import SCALE, pool, record, rows_of

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.selection import select
from jaxnarx.settings import Backward, ForwardOLS, SimulationOLS, StepwiseF

METHODS = {
    "forward": ForwardOLS(max_terms=8),
    "stepwise": StepwiseF(max_terms=12),
    "backward": Backward(max_terms=12),
    "simulation": SimulationOLS(max_terms=6, shortlist=10, steps=3, patience=1),
}


def spoiled(channel: int, values) -> list[np.ndarray]:
    rows = [rows_of("white")[0].copy()]
    rows[0][:, channel] = values
    return rows


def near_copy() -> list[np.ndarray]:
    """b is a, but for the rounding of thirteen digits."""
    a = rows_of("white")[0][:, A]
    noise = np.random.default_rng(1).normal(size=len(a))
    return spoiled(B, a * (1 + 1e-9 * noise))


def gaps() -> list[np.ndarray]:
    rows = [rows_of("white")[0].copy()]
    rows[0][40:45, A] = np.nan
    rows[0][100, Y] = np.nan
    return rows


FINE = {
    "constant channel": lambda: spoiled(B, 3.0),
    "zero channel": lambda: spoiled(B, 0.0),
    "copy": lambda: spoiled(B, rows_of("white")[0][:, A]),
    "near copy": near_copy,
    "gaps": gaps,
    "noise-free": lambda: [record("white", noise=0.0)],
}


SLOWLY = [
    pytest.param(name, marks=pytest.mark.slow) if name == "simulation" else name
    for name in METHODS
]


@pytest.mark.parametrize("fault", FINE)
@pytest.mark.parametrize("method", SLOWLY)
def test_terms_are_found_all_the_same(method, fault):
    solution = select(pool(), common.from_rows(FINE[fault]()), METHODS[method])
    value = solution.value
    assert "y[t-1]" in value.names
    for name in ("err", "coefficient", "error", "sse", "press", "nested"):
        assert np.all(np.isfinite(getattr(value, name))), name
    for name in ("bic", "fpe", "t", "p_value", "adjusted_r2", "overall_f"):
        assert np.all(np.isfinite(solution.stats[name])), name
    if fault in ("constant channel", "zero channel", "copy", "near copy"):
        assert not any("b[" in name for name in value.names)
        assert set(solution.stats["passed_over"]) == {"b"}


def dead_output() -> Dataset:
    return common.from_rows(spoiled(Y, 5.0))


def all_masked() -> Dataset:
    rows = [rows_of("white")[0].copy()]
    rows[0][:, Y] = np.nan
    return common.from_rows(rows)


def too_few() -> Dataset:
    return common.from_rows([rows_of("white")[0][:6]])


ERRORS = {
    "constant output": (dead_output, "constant"),
    "all masked": (all_masked, "constant|usable|missing|NaN|valid"),
    "fewer samples than terms": (too_few, "need at least"),
}


@pytest.mark.parametrize("fault", ERRORS)
@pytest.mark.parametrize("method", METHODS)
def test_what_cannot_be_identified_is_an_error(method, fault):
    make, said = ERRORS[fault]
    with pytest.raises(DataError, match=said):
        select(pool(), make(), METHODS[method])


def test_two_columns_where_one_output_is_meant_are_refused():
    u, y = np.random.default_rng(0).normal(size=(2, 40, 2)) * SCALE[:2]
    with pytest.raises(SpecError, match="shape"):
        Dataset.from_arrays(u, y, inputs=["a", "b"], outputs=["y"], sample_time=0.1)
