"""What `print` and a notebook show of the values that people look at."""

import ast
from functools import cache
from typing import Any

import common
import jax
import numpy as np
import pytest
from test_architecture import modules, parsed

import jaxnarx as jnx
from jaxnarx.formatting import (
    align_columns,
    brief,
    count,
    page,
    ratio_text,
    some,
    span_text,
)
from jaxnarx.identification import Candidate, Leaderboard
from jaxnarx.sweep import SweepTable


@cache
def hostile() -> jnx.Dataset:
    """Names that would be markup."""
    rng = np.random.default_rng(0)
    names: dict[str, Any] = {"inputs": ["<script>u"], "outputs": ["<b>y&"]}
    u, y = rng.normal(size=(2, 80))
    return jnx.Dataset.from_arrays(u, y, sample_time=0.5, **names)


def shown_in_notebooks() -> list[tuple[str, set[str]]]:
    """Classes of the package that tell their text, and the names in their bodies."""
    found = []
    for module, path in modules().items():
        for node in ast.walk(parsed(path)):
            if not isinstance(node, ast.ClassDef):
                continue
            names = {
                name.id
                for part in node.body
                for name in ast.walk(part)
                if isinstance(name, ast.Name)
            }
            methods = {p.name for p in node.body if isinstance(p, ast.FunctionDef)}
            if "__str__" in methods:
                found.append((f"{module}.{node.name}", names))
    return found


def test_what_prints_well_shows_in_notebooks():
    found = shown_in_notebooks()
    assert len(found) > 30, "the classes were not found"
    assert not [name for name, words in found if "_repr_html_" not in words]


def test_nothing_in_a_value_is_markup():
    data = hostile()
    lags: dict[str, Any] = {"input_lags": (0,), "output_lags": (1,), "degree": 1}
    pool = jnx.polynomial_pool(data.channels, **lags)
    chosen = jnx.select(pool, data, jnx.ForwardOLS(max_terms=2))
    network = jnx.grow(chosen.value, data, jnx.Global())
    run = jnx.simulate(network.value, data)
    values = [data, data.channels, pool, chosen, network, network.value, run]
    for value in values:
        text = page(value)
        assert text == value._repr_html_()
        assert "&lt;" in text and "<script>" not in text and "<b>" not in text
        assert text.startswith("<pre>") and text.count("<") == 2


def test_a_dataset_tells_ranges_of_valid_samples_and_its_records():
    rows = common.signals(40)
    rows[3:5, 0] = np.nan
    text = str(common.from_rows([rows, common.signals(20, 1)]))
    both = np.concatenate([np.delete(rows[:, 0], [3, 4]), common.signals(20, 1)[:, 0]])
    figures = both.min(), both.mean(), both.max(), both.std()
    (line,) = [line for line in text.splitlines() if line.startswith("input   a")]
    assert line.split() == ["input", "a", "V", *(f"{x:.4g}" for x in figures), "2"]
    assert "2 records, 60 samples at 0.1 s (6 s)" in text
    assert "record 1: 40 samples, 4 s, 2 with something missing" in text


def test_huge_values_are_told_without_overflow():
    names: dict[str, Any] = {"inputs": ["u"], "outputs": ["y"], "sample_time": 1.0}
    u = 1e150 * np.arange(1.0, 5.0)
    (line,) = [
        line
        for line in str(jnx.Dataset.from_arrays(u, u, **names)).splitlines()
        if line.startswith("input   u")
    ]
    assert line.split()[2:] == ["1e+150", "2.5e+150", "4e+150", "1.118e+150"]


def test_long_lists_are_cut_and_say_so():
    assert some(["a", "b", "c"], 2) == ["a", "b", "c"]
    assert some(list("abcd"), 2) == ["a", "b", "  and 2 more"]
    assert align_columns([("a", "1"), ("bcd", "20")]) == ["a     1", "bcd  20"]


def test_a_solution_tells_how_it_ended():
    good = jnx.Solution(1.5, jnx.RESULTS.budget_spent, {"steps": 3}, "30 steps used up")
    assert str(good) == "budget_spent: 30 steps used up\n1.5\nstats: steps 3"
    assert "Converged" in str(jnx.Solution(0, jnx.RESULTS.ok, {}))

    def ends(x):
        bad = jnx.RESULTS.where(x > 0, jnx.RESULTS.ok, jnx.RESULTS.diverged)
        solution = jnx.Solution(x, bad, {"loss": x})
        assert "Solution" in str(solution)  # a traced one has no text of its own
        return solution

    many = jax.jit(jax.vmap(ends))(jax.numpy.array([1.0, -1.0, 2.0]))
    assert str(many).startswith("2 ok, 1 diverged\n")
    assert str(many).endswith("stats: loss (3)")


def test_a_network_tells_regions_and_equations():
    network = common.named("coupled")
    equations = [one["text"] for one in network.equations()]
    for line in equations:  # these have few terms
        assert line in str(network)
    assert "a[t] near -2.4" in str(network)


def test_a_leaderboard_marks_its_choice():
    rows = [
        Candidate("y", 1, "ARX", "order 1", 0.5, None, (0.5,), operations=9),
        Candidate("y", 2, "OE", "order 2", 0.2, 0.01, (0.2,), operations=30),
        Candidate("y", 3, "OE", "order 3", None, status="diverged"),
    ]
    lines = str(Leaderboard(tuple(rows))).splitlines()
    starred = [line for line in lines if line.startswith("*")]
    assert len(starred) == 1 and "0.2 ± 0.01" in starred[0]
    assert "diverged" in lines[-1]


def test_runs_and_tables_are_one_line_in_a_list():
    run = jnx.simulate(common.named("one model"), common.dataset()).value
    assert repr([run]) == "[<Trajectories: 4 records of y>]"
    assert "record 2" in str(run) and brief(common.dataset()).startswith("<Dataset: 4")
    table = SweepTable.from_rows([{"member": "a", "rmse": 0.123456789}])
    assert str(table).splitlines()[-1].split() == ["a", "0.123457"]


def test_a_table_of_many_columns_shows_what_a_line_holds_and_names_the_others():
    errors = {f"rmse of record {n}": n for n in range(40)}
    row = {"member": "a", "status": "ok"} | errors
    lines = str(SweepTable.from_rows([row, row])).splitlines()
    assert max(map(len, lines)) <= 100
    assert "rmse of record 3" in lines[1] and "rmse of record 39" not in lines[1]
    rest = " ".join(line.strip() for line in lines[4:])
    assert rest.startswith("and rmse of record 4, ")
    assert rest.endswith("record 38, rmse of record 39")


@pytest.mark.parametrize("kind", ["one model", "by inputs"])
def test_a_network_of_long_equations_says_what_it_leaves_out(kind, monkeypatch):
    monkeypatch.setattr("jaxnarx.models.network.SHOWN_TERMS", 2)
    network = common.named(kind)
    terms = int(np.asarray(network.models[0].local.used)[0].sum())
    assert f" + {terms - 2} terms more" in str(network)


def test_ends_of_a_span_are_told_apart():
    assert span_text(1.25, 3.5) == ("1.25", "3.5")
    assert span_text(12.34561, 12.34569) == ("12.34561", "12.34569")
    assert span_text(2.0, 2.0) == ("2", "2")


def test_one_is_one_and_a_ratio_is_no_number_of_something():
    assert [count(n, "sample") for n in (0, 1, 2)] == [
        "0 samples",
        "1 sample",
        "2 samples",
    ]
    found = [ratio_text(x) for x in (1.0, 0.999, 0.1234, 12.0, 0.0, 150.0)]
    assert found == ["1.00", "0.999", "0.123", "12.0", "0", "150"]
