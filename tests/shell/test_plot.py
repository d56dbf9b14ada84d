"""Figures that are public: one call each, from values to a matplotlib figure."""

import ast
import inspect
from functools import cache
from pathlib import Path
from typing import Any

import common
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


def test_training_and_test_and_several_models_are_one_page():
    chosen, network = fitted()
    alone = jnx.grow(chosen, data(), jnx.Global()).value
    parts = {"train": data()[0], "test": data()[1]}
    figure = jnx.plot.compare({"regions": network, "alone": alone}, parts)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert titles == ["train, record 1", "test, record 2"]
    labels = [str(line.get_label()) for line in figure.axes[0].lines]
    assert labels[0] == "measured" and labels[1].startswith("regions: ")
    only = jnx.plot.compare(network, parts, record="record 2")
    assert len(only.axes) == 1
    with pytest.raises(SpecError, match="no record 'x'"):
        jnx.plot.compare(network, parts, record="x")


def test_what_the_model_says_of_its_inputs_is_one_call_each():
    chosen, network = fitted()
    assert "NRMSE of the free run" in texts(jnx.plot.relevance(network, data()))
    figure = jnx.plot.intersections(network, data())
    assert [ax.get_ylabel() for ax in figure.axes] == ["y", "w"]
    curve = figure.axes[1].lines[0]
    # w(t) = u(t-1): at rest a line of slope one, but for the blend of three regions.
    x, y = (np.asarray(a, float) for a in (curve.get_xdata(), curve.get_ydata()))
    np.testing.assert_allclose(y, x, atol=0.05)
    figure = jnx.plot.error_map(network, data(), over=("u", "u[t-1]"))
    assert "RMSE" in texts(figure)
    sizes = jnx.plot.errors_by_size(chosen, {"train": data()[0], "test": data()[1]})
    assert "number of terms" in texts(sizes) and "operations" in texts(sizes)
    free = jnx.plot.residuals(network, data(), over="free run")
    assert "free-run residual" in texts(free)


def test_gates_of_a_tree_are_a_list():
    chosen, network = fitted()
    method = jnx.SigmoidTree("u[t-1]", max_models=2, criterion="none")
    tree = jnx.grow(chosen, data(), method).value
    words = [t.get_text() for t in jnx.plot.gates(tree).axes[0].texts]
    assert any(word.startswith("u[t-1] < ") for word in words)
    with pytest.raises(SpecError, match="are no tree"):
        jnx.plot.gates(network)


def test_a_response_surface_is_a_colour_for_every_pair():
    network, records = common.named("one model"), common.dataset((60, 45))
    figure = jnx.plot.response_surface(network, records, ("a", "b"), cells=4)
    assert figure.axes[0].get_xlabel() == "a [V]" and len(figure.axes) == 2


def test_a_figure_shows_itself_in_a_notebook():
    figure: Any = jnx.plot.partition(fitted()[1], data())
    assert figure._repr_png_().startswith(b"\x89PNG")


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
    with pytest.raises(SpecError, match="over must be one of"):
        jnx.plot.residuals(network, data(), over="time")
