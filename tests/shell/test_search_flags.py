"""Options of a search: what is typed, what is typed again, and what comes next."""

import dataclasses

import pytest

from jaxnarx.errors import SpecError
from jaxnarx.evaluation.verdict import REMEDIES, Reason, Verdict
from jaxnarx.settings import PRESETS, Identification
from jaxnarx.shell.commands import Identify
from jaxnarx.shell.commands.flags import words_of
from jaxnarx.shell.commands.parse import parse
from jaxnarx.shell.commands.search import Automatic
from jaxnarx.shell.next_command import propose_after_search
from jaxnarx.shell.parse_ranges import parse_seconds
from jaxnarx.shell.search.progress import duration
from jaxnarx.shell.search.run import folder_name


def parsed(line: str) -> Identify:
    command = parse(["identify", "a.toml", *line.split()])
    assert isinstance(command, Identify)
    return command


@pytest.mark.parametrize(
    ("line", "asked"),
    [
        ("", Automatic()),
        ("--output NOx CO", Automatic(outputs=("NOx", "CO"))),
        ("--preset ecu --budget 1.5h", Automatic("ecu", 5400.0)),
        ("--budget 90 --candidates 7 --force", Automatic(budget=90.0, candidates=7)),
    ],
)
def test_a_search_and_its_words(line, asked):
    command = parsed(line)
    assert command.method == asked
    assert parse(words_of(command)[1:]) == command


@pytest.mark.parametrize(
    "line",
    ["--degree 2", "--terms 25", "--models 1", "--set refine.tolerance=1e-5"],
)
def test_a_setting_makes_it_one_method_also_where_it_is_the_usual_one(line):
    assert isinstance(parsed(line).method, Identification)


def test_all_presets_can_be_typed():
    for name in PRESETS:
        assert parsed(f"--preset {name}").method == Automatic(name)


@pytest.mark.parametrize(
    ("text", "value"),
    [("90", 90), ("600s", 600), ("10m", 600), ("2 min", 120), (".5h", 1800)],
)
def test_a_budget_in_seconds(text, value):
    assert parse_seconds(text, "--budget") == value


@pytest.mark.parametrize("text", ["", "m", "-3s", "0", "1d", "1e3", "inf", "nan"])
def test_what_is_no_time(text):
    with pytest.raises(SpecError, match="--budget takes a time"):
        parse_seconds(text, "--budget")


def test_the_folder_has_the_name_of_what_is_searched():
    def name(line):
        command = parsed(line)
        assert isinstance(command.method, Automatic)
        return folder_name(command, command.method)

    assert name("") == name("--budget 9m --candidates 3") == "a-good"
    assert name("--output NOx --preset ecu") == "a-NOx-ecu"
    assert name("--output a b c d e") == "a-a-b-c-2_more-good"


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("remedy", ["", *REMEDIES])
def test_what_comes_next_can_be_typed_and_changes_something(preset, remedy):
    asked = Automatic(preset, outputs=("NOx",))
    command = Identify("a.toml", asked)
    found = (Reason("not usable", "why", remedy),) if remedy else ()
    text = propose_after_search(command, asked, Verdict("", found), model="m")
    if not remedy:
        assert text == "jaxnarx simulate m new_run.csv"
        return
    words, remark, _ = text.partition("  (")
    again = parse(words.split()[1:])
    assert isinstance(again, Identify)
    assert remark or again != dataclasses.replace(command)


def test_a_search_goes_on_by_the_same_words():
    command = parsed("--preset best --out there")
    assert isinstance(command.method, Automatic)
    text = propose_after_search(command, command.method, None, model="m")
    assert parse(text.removesuffix("  (goes on)").split()[1:]) == command


@pytest.mark.parametrize(
    ("time", "text"),
    [(0.2, "0 s"), (59.6, "1 min 0 s"), (200.0, "3 min 20 s"), (3900.0, "1 h 5 min")],
)
def test_times_in_words(time, text):
    assert duration(time) == text
