"""Figures that are public: one call each, from values to a matplotlib figure."""

import ast
import inspect
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxnarx as jnx
from jaxnarx.errors import SpecError


@cache
def data() -> jnx.Dataset:
    """Two records of y(t) = 0.5 y(t-1) + u(t-1)^2 and w(t) = u(t-1), with noise."""
    rng = np.random.default_rng(2)
    records = []
    for rows in (150, 120):
        u, y = rng.uniform(-1, 1, rows), np.zeros((rows, 2))
        for t in range(1, rows):
            y[t] = 0.5 * y[t - 1, 0] + u[t - 1] ** 2, u[t - 1]
        records.append((u, y + 0.01 * rng.normal(size=y.shape)))
    names: dict[str, Any] = {"inputs": ["u"], "outputs": ["y", "w"]}
    return jnx.Dataset.from_arrays(
        *map(list, zip(*records, strict=True)), sample_time=0.5, **names
    )


@cache
def fitted() -> tuple[jnx.Selection, jnx.Network]:
    lags: dict[str, Any] = {"input_lags": (1,), "output_lags": (1,), "degree": 1}
    pool = jnx.polynomial_pool(data().channels, **lags)
    chosen = jnx.select(pool, data(), jnx.ForwardOLS(max_terms=3)).value
    method = jnx.Lolimot("u[t-1]", max_models=3, criterion="none")
    return chosen, jnx.grow(chosen, data(), method).value


def texts(figure: Figure) -> str:
    """All that is written on a figure's axes."""
    words = []
    for ax in figure.axes:
        words += [ax.get_title(loc="left"), ax.get_xlabel(), ax.get_ylabel()]
        words += [t.get_text() for t in ax.get_yticklabels()]
    return "\n".join(words)


def test_a_network_a_free_run_a_selection_and_residuals_are_one_call_each():
    chosen, network = fitted()
    assert "u[t-1]" in texts(jnx.plot.partition(network, data(), start=network))
    assert "u[t-1]" in texts(jnx.plot.selection_path(chosen, output="w"))
    assert "lag [samples]" in texts(jnx.plot.residuals(network, data()))
    over = jnx.plot.residuals(network, data(), over="operating points")
    assert "equal means" in texts(over)
    assert jnx.plot.local_models(network, data()).axes


def test_a_free_run_is_drawn_of_the_record_and_output_asked_for():
    _, network = fitted()
    run = jnx.simulate(network, data()).value
    for record, name in ((0, "y"), (1, "w")):
        figure = jnx.plot.free_run(network, data(), record=record, output=name)
        lines = {line.get_label(): line for line in figure.axes[0].lines}
        drawn = np.asarray(lines["free run"].get_ydata())
        np.testing.assert_allclose(
            drawn, run.outputs[record][:, ["y", "w"].index(name)], rtol=1e-12
        )
        assert texts(figure).startswith(f"{name}, record")


def test_every_public_figure_says_what_it_shows():
    for name in jnx.plot.__all__:
        assert inspect.getdoc(getattr(jnx.plot, name)), name


def test_every_figure_is_public_or_drawn_by_a_command_or_a_report():
    """What nothing here draws belongs to the experiment that does."""
    shell = Path(jnx.plot.__file__).parent
    trees = {path.stem: ast.parse(path.read_text()) for path in shell.glob("*.py")}
    drawn = {
        (module, node.name)
        for module, tree in trees.items()
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")
        if node.returns is not None and ast.unparse(node.returns).startswith("Figure")
    }
    called = {
        name.attr if isinstance(name, ast.Attribute) else name.id
        for tree in trees.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        if isinstance(name := node.func, ast.Name | ast.Attribute)
    }
    assert len(drawn) > 10, "the figures were not found"
    idle = {
        f"{module}.{name}"
        for module, name in drawn
        if name not in called.union(jnx.plot.__all__)
    }
    assert not idle


def test_wrong_use_says_what_to_do():
    chosen, network = fitted()
    alone = jnx.grow(chosen, data(), jnx.Global()).value
    with pytest.raises(SpecError, match="no partition to draw"):
        jnx.plot.partition(alone)
    with pytest.raises(SpecError, match="no output 'z'"):
        jnx.plot.free_run(network, data(), output="z")
    with pytest.raises(SpecError, match="over is"):
        jnx.plot.residuals(network, data(), over="time")
