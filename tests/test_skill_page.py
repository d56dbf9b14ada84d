"""Pages for assistants and the glossary: what they name is there, and nothing is left
out."""

import csv
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxnarx.evaluation import Report
from jaxnarx.evaluation.verdict import GOOD, LIMITED, REMEDIES, UNUSABLE
from jaxnarx.settings import PRESETS
from jaxnarx.shell import cli
from jaxnarx.shell.cli import run
from jaxnarx.shell.commands import COMMANDS
from jaxnarx.shell.commands.flags import add_options
from jaxnarx.shell.commands.parse import parse
from jaxnarx.shell.interrupt import ENDING_SIGNALS
from jaxnarx.solution import OKAY_STATUSES, STATUS_NAMES
from jaxnarx.sweep import read_sweep

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGE = (DOCS / "SKILL.md").read_text("utf-8")
TOML = """[data]
sample_time = 0.1
[channels.inputs]
a = "V"
[channels.outputs]
y = "ppm"
[records]
train = ["r0.csv", "r1.csv", "r2.csv"]
"""
SWEEP = """[data]
engines = ["short.toml"]
[identification.select]
max_terms = 3
[cases]
refine.ridge = [1e-6, 1e-4]
"""


def section(title: str) -> str:
    """The text below a heading, up to the next of the same or a higher level."""
    found = re.search(rf"^(#+) {re.escape(title)}\n", PAGE, re.M)
    assert found is not None, f"no section {title!r}"
    rest = PAGE[found.end() :]
    return re.split(rf"^#{{1,{len(found[1])}}} ", rest, maxsplit=1, flags=re.M)[0]


def table(text: str, head: str) -> list[list[str]]:
    """Cells of the table whose first column is called so."""
    block = text.split(f"| {head} |", 1)[1].splitlines()[2:]
    rows = []
    for line in block:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def spans(text: str) -> list[str]:
    return re.findall(r"`([^`\n]+)`", text)


def keys(title: str, head: str = "key") -> list[str]:
    """Keys in the first column of a section's table."""
    found = [k for row in table(section(title), head) for k in spans(row[0])]
    assert found
    return found


def options(command: type) -> set[str]:
    """Options of a command as they are typed."""
    names = add_options(command).__dataclass_fields__
    return {f"--{name.replace('_', '-')}" for name in names}


# Commands and flags ---------------------------------------------------------------


def command_of(words: list[str]) -> str:
    """The command of a line, of one word or of two."""
    two = " ".join(words[1:3])
    return two if two in COMMANDS else words[1]


def test_every_command_is_named_with_an_example_that_parses():
    examples = [spans(row[1])[0] for row in table(section("Which command"), "task")]
    words = [shlex.split(line) for line in examples]
    assert {command_of(line) for line in words} == set(COMMANDS)
    for line in words:
        assert line[0] == "jaxnarx"
        parse(line[1:])


def test_every_command_has_a_section_of_flags_that_it_has():
    titles = re.findall(r"^### jaxnarx ([a-z]+(?:[ -][a-z]+)*)$", PAGE, re.M)
    assert sorted(titles) == sorted(COMMANDS)
    for name in titles:
        named = set(re.findall(r"(?<![\w-])--[a-z][\w-]*", section(f"jaxnarx {name}")))
        assert named <= options(COMMANDS[name]), name


def test_every_flag_elsewhere_belongs_to_a_command():
    every = set[str]().union(*map(options, COMMANDS.values()))
    for span in spans(PAGE):
        named = set(re.findall(r"(?<![\w-])--[a-z][\w-]*", span)) - {"--help"}
        words = span.split()
        named_one = words[0] == "jaxnarx" and len(words) > 1
        own = command_of(words) if named_one else ""
        assert named <= (options(COMMANDS[own]) if own in COMMANDS else every), span


def test_every_preset_is_explained():
    named = set(spans(section("jaxnarx identify")))
    assert set(PRESETS) <= named


# Codes and words ------------------------------------------------------------------


def test_exit_codes_are_those_of_the_command_line():
    codes = [int(row[0]) for row in table(section("Exit codes"), "code")]
    own = [
        cli.EXIT_OK,
        cli.EXIT_NOT_ACCEPTABLE,
        cli.EXIT_USAGE,
        cli.EXIT_DATA,
        cli.EXIT_DEFECT,
    ]
    assert codes == [*own, *(128 + number for number in ENDING_SIGNALS)]
    assert cli.EXIT_INTERRUPTED in codes


def test_every_status_is_explained_in_the_order_of_the_program():
    rows = table(section("Statuses"), "status")
    assert tuple(spans(row[0])[0] for row in rows) == STATUS_NAMES
    assert all(all(row) and len(row) == 3 for row in rows)
    assert OKAY_STATUSES == 4 and "The first four" in section("Statuses")


def test_levels_and_remedies_are_those_of_the_verdict():
    rows = {row[0]: row[1] for row in table(section("report.json"), "key")}
    levels = spans(rows["`verdict.level`"])
    assert levels == [GOOD, LIMITED, UNUSABLE]
    assert spans(rows["`verdict.findings[].remedy`"]) == list(REMEDIES)
    failures = set(spans(section("When something fails")))
    assert set(REMEDIES) - {"linear"} <= failures


# Files ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Iterator[Path]:
    """The folder of a small search without test records, by the real program."""
    folder = tmp_path_factory.mktemp("skill")
    for k in range(3):
        rng = np.random.default_rng(k)
        u = np.repeat(rng.uniform(-1, 1, 20), 6)
        y = np.zeros(120)
        for t in range(1, 120):
            y[t] = 0.7 * y[t - 1] + u[t - 1]
        rows = np.stack([u, y + 3 + 0.05 * rng.standard_normal(120)], axis=1)
        np.savetxt(folder / f"r{k}.csv", rows, delimiter=",", header="a,y", comments="")
    (folder / "engine.toml").write_text(TOML)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("JAXNARX_DATA", raising=False)
        # the page of the report is no part of what is read here
        patch.setattr(Report, "to_html", lambda self, path: Path(path).touch())
        typed = "identify engine.toml --preset linear --candidates 3 --out run"
        assert run(shlex.split(typed)) == 0
        yield folder


def at(value: Any, path: str) -> Any:
    """The value that a key of the page leads to; else IndexError or KeyError."""
    for word in path.split("."):
        name = word.removesuffix("[]")
        value = next(iter(value.values())) if name.startswith("<") else value[name]
        value = value[0] if word.endswith("[]") else value
    return value


def missing(value: Any, title: str, head: str = "key") -> list[str]:
    """Keys of a section that are not in a file."""
    lost = []
    for path in keys(title, head):
        try:
            at(value, path)
        except (KeyError, IndexError, StopIteration):
            lost.append(path)
    return lost


def test_keys_of_the_report(place):
    found = json.loads((place / "run/report.json").read_text())
    assert not missing(found, "report.json")
    assert found["verdict"]["level"] == LIMITED


def test_a_key_that_is_not_there_is_found():
    assert at({"a": [{"b": 1}]}, "a[].b") == 1 and at({"a": {"y": 2}}, "a.<output>")
    with pytest.raises(KeyError):
        at({"a": [{"b": 1}]}, "a[].c")
    with pytest.raises(IndexError):
        at({"a": []}, "a[].b")


def test_columns_of_the_leaderboard(place):
    with open(place / "run/leaderboard.csv") as file:
        names = csv.DictReader(file).fieldnames or []
    assert not set(keys("leaderboard.csv", "column")) - set(names)


def test_keys_and_files_of_a_search(place):
    found = json.loads((place / "run/search.json").read_text())
    assert not missing(found, "search.json")
    files = [s for s in spans(section("Files to read").split("###")[0]) if "." in s]
    there = {path.name for path in (place / "run").iterdir()}
    assert there == {"candidates", *files}


@pytest.mark.parametrize("model", [False, True])
def test_keys_of_check(place, capsys, model):
    capsys.readouterr()
    more = ["--model", "run/model.safetensors"] if model else []
    assert run(["check", "engine.toml", *more, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert not missing(found, f"jaxnarx check {'--model ' * model}--json")


def test_columns_of_simulate(place):
    line = "simulate run/model.safetensors r0.csv --level 0.9"
    assert run(line.split()) == 0
    with open(place / "simulated/r0.csv") as file:
        columns = csv.DictReader(file).fieldnames or []
    named = {s for s in spans(section("Columns of simulate")) if "--" not in s}
    named -= {"NAME predicted"}
    assert {name.replace("y ", "NAME ") for name in columns} == named | {"time [s]"}


def test_columns_of_a_sweep(place):
    """Of an engine whose records are too short for any fit to begin."""
    parts = {"train": "s0.csv", "validate": "s1.csv", "test": "s2.csv"}
    for n, file in enumerate(parts.values()):
        (place / file).write_text(f"a,y\n1,2\n2,{3 + n}\n")
    head = TOML.partition("train")[0]
    text = head + "\n".join(f'{part} = ["{file}"]' for part, file in parts.items())
    (place / "short.toml").write_text(text)
    (place / "sweep.toml").write_text(SWEEP)
    assert run(["sweep", "sweep.toml", "--folder", "sweep"]) == 0
    named = keys("Folder of a sweep", "column")
    assert not set(named) - set(read_sweep("sweep").names)
    manifest = json.loads((place / "sweep/manifest.json").read_text())
    assert not missing(manifest, "Folder of a sweep", "key of `manifest.json`")
    there = {path.name for path in (place / "sweep").iterdir()}
    assert set(spans(section("Folder of a sweep").split("\n|")[0])) & there == {
        *("table.parquet", "table.csv", "chunks", "manifest.json")
    }


# Where the pages are --------------------------------------------------------------


def test_the_page_is_in_the_documentation_and_at_its_root():
    assert "{include} SKILL.md" in (DOCS / "assistants.md").read_text()
    index = (DOCS / "index.md").read_text()
    assert {"assistants", "glossary"} <= set(index.split())
    (line,) = re.findall(
        r"^html_extra_path = .*$", (DOCS / "conf.py").read_text(), re.M
    )
    assert '"llms.txt"' in line and '"SKILL.md"' in line


def test_every_link_of_llms_txt_leads_to_a_page():
    text = (DOCS / "llms.txt").read_text("utf-8")
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert text.startswith("# jaxnarx\n\n> ") and len(links) > 10
    made = {"reference/made/commands", "reference/made/description"}
    made |= {"reference/made/names"}
    for link in links:
        page = link.removesuffix(".html")
        there = DOCS / (link if link == page else f"{page}.md")
        assert there.is_file() or page in made, link


def test_the_glossary_is_sorted_and_every_term_is_linked():
    text = (DOCS / "glossary.md").read_text("utf-8")
    body = text.split("```{glossary}\n")[1].split("```")[0]
    entries = [entry.split("\n", 1) for entry in body.strip().split("\n\n")]
    terms = [term for term, _ in entries]
    assert len(terms) > 50 and terms == sorted(terms, key=str.lower)
    for term, words in entries:
        pages = re.findall(r"\{doc\}`([^`]+)`", words)
        assert pages, f"{term} has no link"
        sentences = re.split(
            r"(?<=[.!?]) ", " ".join(words.split("See {doc}")[0].split())
        )
        assert 1 <= len([s for s in sentences if s]) <= 3, term
    named = {t.lower() for t in terms}
    used = re.findall(r"\{term\}`([^`]+)`", body)
    assert {" ".join(t.lower().split()) for t in used} <= named
