"""The documentation says what there is: names, options, messages, figures, floors."""

import ast
import importlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
from test_architecture import HOUSE, RANK
from tyro.conf import Positional

import jaxnarx
from jaxnarx import settings
from jaxnarx.docstrings import field_texts
from jaxnarx.errors import JaxnarxError
from jaxnarx.settings.tree import replace_at
from jaxnarx.shell.commands import COMMANDS
from jaxnarx.shell.commands.flags import add_options
from jaxnarx.shell.commands.parse import parse
from jaxnarx.solution import STATUS_NAMES

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


@cache
def making(name: str) -> Any:
    """A module of `docs/making`."""
    folder = str(DOCS / "making")
    sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(folder)


@cache
def reference() -> dict[str, Any]:
    """What the scripts find: pages, names with their paths, texts, imports.

    In a process of its own, where the package is imported without the type check of
    every function: as the documentation is built, and in a fifth of the time.
    """
    code = (
        "import json, reference, messages, commands, house\n"
        "pages = reference.made() | messages.made() | commands.made()\n"
        "texts = [(m.kind, m.text) for m in messages.found()]\n"
        "print(json.dumps({'pages': pages, 'known': reference.known(), "
        "'texts': texts, 'unread': messages.unread(), "
        "'imports': sorted(house.imports())}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=DOCS / "making",
        env=os.environ | {"JAXTYPING_DISABLE": "1", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


# Names and options ----------------------------------------------------------------


def test_every_public_name_is_in_the_reference_once():
    text = "\n".join(reference()["pages"].values())
    described = re.findall(
        r"\{py:(?:class|function|exception|data|module)\} ([\w.]+)", text
    )
    twice = {path for path in described if described.count(path) > 1}
    assert not twice
    assert {f"jaxnarx.{name}" for name in jaxnarx.__all__} <= set(described) | {
        "jaxnarx.plot"
    }
    known = reference()["known"]
    rooms = set(dir(jaxnarx)) - set(jaxnarx.__all__)
    assert len(rooms) > 10
    for room in rooms:
        names = offered(room)
        assert len(names) > 1
        for name in names:
            assert known[f"{room}.{name}"] in described, f"{room}.{name}"


def offered(room: str) -> set[str]:
    """Names of a room by its `__init__`, without importing it."""
    path = Path(jaxnarx.__file__).parent / room
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    body = ast.parse(path.read_text()).body
    for node in body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    imported = [
        a for node in body if isinstance(node, ast.ImportFrom) for a in node.names
    ]
    return {a.name for a in imported if a.asname == a.name}


def test_every_setting_stands_in_the_reference_with_its_sentence():
    text = " ".join("\n".join(reference()["pages"].values()).split())
    text = re.sub(r"\{py:obj\}`([^`<]*?) <[^>]*>`", r"`\1`", text)
    kinds: list[Any] = [getattr(settings, name) for name in settings.__all__]
    count = 0
    for kind in kinds:
        if not hasattr(kind, "__dataclass_fields__"):
            continue
        for field, words in field_texts(kind).items():
            first = making("docstrings").prose(" ".join(words.split()[:3]), {})
            assert f"- `{field}`: {first}" in text, f"{kind.__name__}.{field}"
            count += 1
    assert count > 100


def test_every_option_of_a_command_is_on_its_page():
    page, missing = reference()["pages"]["commands.md"], []
    typed: Any = Positional[int]
    for name, command in COMMANDS.items():
        own = page.partition(f"## jaxnarx {name}\n")[2].partition("\n## ")[0]
        wanted = [f"usage: jaxnarx {name} "]
        hints = get_type_hints(add_options(command), include_extras=True)
        for field, hint in hints.items():
            if typed.__metadata__[0] not in getattr(hint, "__metadata__", ()):
                wanted.append(f"--{field.replace('_', '-')}")
        assert hints
        missing += [(name, text) for text in wanted if text not in own]
    assert not missing


# Messages -------------------------------------------------------------------------

PASSED_ON = {
    "checks.py",
    "data/description.py",
    "data/preparation/step.py",
    "data/readers/sandbox.py",
    "models/validate.py",
    "partition/fixed.py",
    "shell/commands/flags.py",
    "shell/control.py",
    "shell/messages.py",
    "shell/plan.py",
    "shell/sweep/description.py",
    "solution.py",
    "sweep/folder/chunks.py",
}
"""Files that raise what they have been given, with a place in front of it: its words
are found where they are made."""


def test_every_error_that_is_raised_has_a_text_that_was_found():
    assert {line.split(":")[0] for line in reference()["unread"]} <= PASSED_ON


def matches(template: str, text: str) -> bool:
    parts = making("texts").split(template)
    pattern = "".join(
        r".*?" if n % 2 else re.escape(part) for n, part in enumerate(parts)
    )
    return re.fullmatch(pattern, text, re.S) is not None


def wrong_calls(folder: Path) -> dict[str, Callable[[], object]]:
    """Requests that cannot be met, one of every kind and room that costs no compile."""
    u, y = np.zeros((30, 1)), np.zeros((30, 1))
    named: dict[str, Any] = {"inputs": ["u"], "outputs": ["y"], "sample_time": 1.0}
    rng = np.random.default_rng(0)
    data = jaxnarx.Dataset.from_arrays(
        rng.normal(size=(30, 1)), rng.normal(size=(30, 1)), **named
    )
    junk = folder / "junk.safetensors"
    junk.write_bytes(b"no model")
    toml = folder / "bad.toml"
    toml.write_text("[data]\nsample_tim = 1\n")
    channels, gaps = data.channels, np.where(np.arange(30) == 3, np.nan, 1.0)[:, None]
    from_arrays = jaxnarx.Dataset.from_arrays
    pool: dict[str, Any] = {"input_lags": (1,), "output_lags": (1,), "degree": 1}
    high: dict[str, Any] = pool | {"degree": 9}
    return {
        "setting": lambda: jaxnarx.ForwardOLS(max_terms=0),
        "kind of setting": lambda: replace_at(
            jaxnarx.Identification(), {"refine.loss": "cubes"}
        ),
        "rows": lambda: from_arrays(u[:20], y, **named),
        "transposed": lambda: from_arrays(u.T, y, **named),
        "text": lambda: from_arrays(u.astype(str), y, **named),
        "gaps": lambda: from_arrays(gaps, y, **named),
        "no file": lambda: jaxnarx.read(folder / "none.toml"),
        "key": lambda: jaxnarx.read(toml),
        "junk": lambda: jaxnarx.load(junk),
        "degree": lambda: jaxnarx.polynomial_pool(channels, **high),
        "output": lambda: jaxnarx.polynomial_pool(channels, outputs=["z"], **pool),
        "command": lambda: parse(["identity", "engine.toml"]),
        "option": lambda: parse(["identify", "e.toml", "--models", "3"]),
        "path": lambda: parse(["identify", "e.toml", "--set", "refine.tolerace=1"]),
    }


def test_what_is_raised_is_on_the_page(tmp_path):
    # A text from a call, not from the script that made the page: its oracle.
    templates = [t for kind, t in reference()["texts"] if kind == "error"]
    texts = {}
    for name, call in wrong_calls(tmp_path).items():
        with pytest.raises(JaxnarxError) as caught:
            call()
        texts[name] = str(caught.value)
    unknown = {
        name: text
        for name, text in texts.items()
        if not any(matches(template, text) for template in templates)
    }
    assert not unknown
    assert not any(matches(template, "all is well") for template in templates)


def test_every_status_has_advice():
    rows = re.findall(
        r"^\| `(\w+)` \|.*\|(.+)\|$", (DOCS / "reference/messages.md").read_text(), re.M
    )
    assert set(STATUS_NAMES) <= {name for name, advice in rows if advice.strip()}


def test_texts_of_branches_and_variables_are_read():
    code = """
def f(name, long):
    what = f"{name} is"
    if long:
        what += " far too long"
    else:
        what += " short"
    raise SpecError(what + ("." if name else "!"))
"""
    texts = making("texts")
    tree = ast.parse(code)
    call: Any = tree.body[0]
    call = call.body[-1].exc.args[0]
    found = texts.Reader(tree).texts(call, tree.body[0])
    assert {"{name} is far too long.", "{name} is short!"} <= set(found)
    assert not any("long short" in text for text in found)
    assert texts.split("a {x[{1}]} b {{c}}") == ["a ", "x[{1}]", " b {c}"]


# Figures and floors ---------------------------------------------------------------


def test_the_readmes_table_is_the_recorded_one():
    path = ROOT / "experiments/benchmarks/results/gengine1_identify.json"
    recorded = {
        row["output"]: row
        for row in json.loads(path.read_text())["figures"]["good"]["rows"]
    }
    names = {
        "exhaust temperature": "T_exhaust",
        "catalyst temperature": "T_catalyst",
        "particle number": "PN",
    }
    lines = (ROOT / "README.md").read_text().splitlines()
    first = next(n for n, line in enumerate(lines) if line.startswith("| output |"))
    rows = [re.sub(r"\*", "", r).strip("| ").split(" | ") for r in lines[first + 2 :]]
    rows = rows[: next(n for n, row in enumerate(rows) if len(row) == 1)]
    assert len(rows) == len(recorded)
    for name, one, free, trees, lstm, operations in rows:
        row = recorded[names.get(name, name)]
        test = row["test"]
        told = [float(v) for v in (one, free, trees, lstm)]
        assert told == pytest.approx(
            [
                test["one_step"]["rmse"],
                test["free_run"]["rmse"],
                row["beside"]["trees"],
                row["beside"]["LSTM"],
            ],
            abs=5.001e-4,  # three decimals are printed
        )
        assert int(operations) == row["operations"]


def test_tables_are_made_of_every_recorded_aim():
    figures = making("figures")
    text = figures.aims()
    assert text.count("| yes |") + text.count("| **no** |") > 80
    # The largest of the failures must not go missing.
    assert "| verbs" in text or "## verbs" in text
    assert all(part.strip() for part in figures.made().values())


def test_tables_in_the_tree_are_current():
    """Parts of pages that are read as text; docs/making/pages.py makes them anew."""
    made = {f"figures/{n}": t for n, t in making("figures").made().items()}
    made |= {f"thesis/{n}": t for n, t in making("thesis").made().items()}
    made |= {f"reference/{n}": t for n, t in reference()["pages"].items()}
    parts = {n: t for n, t in made.items() if Path(n).name.startswith("_")}
    there = {
        f"{path.parents[1].name}/{path.name}": path.read_text("utf-8")
        for path in DOCS.glob("*/made/_*.md")
    }
    stale = [n for n in {**parts, **there} if parts.get(n) != there.get(n)]
    assert not stale, f"{stale}: run `python docs/making/pages.py`"


def test_the_drawing_has_every_room_and_lines_point_down():
    house = making("house")
    floor = {room: n for n, rooms in enumerate(house.FLOORS.values()) for room in rooms}
    rooms = {room.split(".")[0] for room in RANK} | {"engines"}
    assert set(floor) == rooms
    down = {(a, b) for a, b in reference()["imports"] if floor[a] > floor[b]}
    # A report writes itself as HTML, see EXCEPTIONS of the architecture's tests.
    assert down == {("evaluation", "shell")}
    svg = house.drawing()
    assert all(f">{room}</text>" in svg for room in rooms)


def test_the_architecture_names_every_room_in_its_order_and_files_that_are_there():
    text = (ROOT / "ARCHITECTURE.md").read_text()
    rows = re.findall(r"^\| (?:ground|\d [\w ]+) \| (.*?) \|", text, re.M)
    told = [
        set(re.findall(r"`(\w+)`", rooms)) - {"engines"}
        for row in rows
        for rooms in re.split(r"<|;", row)
    ]
    assert [rooms for rooms in told if rooms] == [set(rooms) for rooms in HOUSE]
    assert "`engines`" in text
    paths = re.findall(r"`((?:\w+/)+\w+(?:\.py)?|\w+\.py)`", text)
    places = [ROOT, Path(jaxnarx.__file__).parent]
    places.append(places[1] / "identification")
    assert len(paths) > 15
    assert not [p for p in paths if not any((place / p).exists() for place in places)]


# Nothing from outside -------------------------------------------------------------


@pytest.mark.parametrize(
    ("page", "fetched"),
    [
        ('<script src="https://a.b/c.js"></script>', ["https://a.b/c.js"]),
        ('<link rel="stylesheet" href="//a.b/c.css">', ["//a.b/c.css"]),
        ('<img src="http://a.b/c.png">', ["http://a.b/c.png"]),
        ("<style>@import 'https://a.b/c.css';</style>", ["https://a.b/c.css"]),
        ('<p style="background:url(https://a.b/c.png)">', ["https://a.b/c.png"]),
        ('<img srcset="x.png, https://a.b/c.png 2x">', ["https://a.b/c.png 2x"]),
        ('<a href="https://a.b">a link</a><img src="c.png">', []),
        ('<link rel="canonical" href="https://a.b/c.html">', []),
    ],
)
def test_what_a_page_would_fetch_is_found(page, fetched):
    assert making("outside").in_page(page) == fetched


def test_a_folder_without_pages_is_no_proof(tmp_path):
    with pytest.raises(SystemExit, match="no pages"):
        making("outside").in_folder(tmp_path)


# What pages print -----------------------------------------------------------------


def test_what_a_command_prints_in_chunks_is_shown_in_one_piece():
    def chunk(name, *text):
        return {"output_type": "stream", "name": name, "text": list(text)}

    figure = {"output_type": "display_data"}
    outputs = [chunk("stderr", "no"), chunk("stdout", "a\n", "lin"), figure]
    outputs += [chunk("stdout", "e\n\n"), chunk("stderr", "te\n"), chunk("stdout", "b")]
    found = making("streams").joined(outputs)
    assert found[1] is figure and len(found) == 3
    assert found[0]["text"] == "a\nline\n\nb\n" and found[2]["text"] == "note\n"


def test_words_of_the_leaderboard_are_explained():
    """Columns, families and every word that a name of a candidate may hold."""
    from jaxnarx.shell.search.leaderboard import COLUMN_NAMES

    page = (DOCS / "reference" / "leaderboard.md").read_text()
    words = [name.replace("_", " ") for name in COLUMN_NAMES]
    words += "lags by 16|4 filters|gates moved|feedback moved|pull 0.1".split("|")
    words += "given up after 2 of 5 groups|shared feedback|hidden states".split("|")
    words += "skipped|diverged|failed|order 2|degree 2|regions|states".split("|")
    assert [word for word in words if word not in page] == []


def test_every_capability_has_a_name_a_command_and_tests_that_are_there():
    page = (ROOT / "docs" / "project" / "capabilities.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1:-1] for line in page.splitlines() if line.startswith("|")]
    assert len(rows) > 35
    missing = []
    for _, library, command, tests in rows[2:]:
        for path in re.findall("`([^`]+)`", tests):
            missing += [] if (ROOT / path).is_file() else [path]
        for name in re.findall("`([^`]+)`", library):
            found = jaxnarx
            for part in name.split(".")[1:]:
                found = getattr(found, part, None)
            missing += [name] if found is None else []
        for name in re.findall("`([^`]+)`", command):
            missing += [] if name in COMMANDS else [name]
    assert not missing
