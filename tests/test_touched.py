"""What decides which tests run, and how many faults they find."""

import mutants
import programs
import touched


def test_what_everybody_needs_touches_every_experiment():
    every = touched.touched(["pyproject.toml"])
    assert len(every) > 40 and len(every) == len(set(every))
    assert all(name.split("::")[0] in touched.TESTS for name in every)


def test_a_file_touches_what_leads_to_it_and_no_more():
    every = set(touched.touched(["pyproject.toml"]))
    diesel = set(touched.touched(["jaxnarx/engines/diesel.py"]))
    least_squares = set(touched.touched(["jaxnarx/arrays/_least_squares.py"]))
    assert "tests/test_experiments.py::test_engines" in diesel
    assert diesel < every and least_squares < every
    fitting = "tests/test_experiments.py::test_fitting_without_peers"
    assert fitting in least_squares and fitting not in diesel
    page = set(touched.touched(["docs/index.md"]))
    assert page <= {"tests/test_experiments.py::test_command_line"} | diesel


def test_names_are_followed_through_rooms_to_their_files():
    found = touched.home("jaxnarx.models", "Network")
    assert found == touched.PACKAGE / "models" / "network.py"
    assert touched.deepest(["linear", "ARX"]) != touched.module("jaxnarx.linear")


def test_changes_are_one_at_a_time_and_of_what_is_run(tmp_path, monkeypatch):
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    path = tmp_path / "a.py"
    path.write_text(
        'LIMIT = 3\n\n\ndef f(x: int = 1) -> int:\n    """Of 2."""\n'
        "    if x < 4 and x[0]:\n        raise ValueError(5)\n    return x - 0.5\n"
    )
    found = [(m["line"], m["old"], m["new"]) for m in mutants.sites(path)]
    assert sorted(found) == [
        (6, "0", "1"),
        (6, "4", "5"),
        (6, "<", "<="),
        (6, "and", "or"),
        (8, "-", "+"),
        (8, "0.5", "1.5"),
    ]


def test_a_file_without_a_record_has_the_least_budget():
    assert programs.budget("tests/test_that_is_not_there.py") >= programs.LEAST
