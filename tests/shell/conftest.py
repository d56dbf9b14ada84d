"""Fixtures of the command line's tests."""

import dataclasses
import pickle
import shlex
from typing import Any

import pytest

from jaxnarx.shell.cli import run


@pytest.fixture(scope="module", autouse=True)
def no_data_folder():
    """Files stand beside their descriptions, whatever the user has set."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("JAXNARX_DATA", raising=False)
        yield


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    """Makes the working folder: a file a part by `write(path, seed)`, and engine.toml.

    Columns are speed, load and temp at 0.1 s.
    """
    with pytest.MonkeyPatch.context() as patch:

        def make(write):
            folder = tmp_path_factory.mktemp("engine")
            for k in range(3):
                write(folder / f"r{k}.csv", k)
            lines = ["[data]", "sample_time = 0.1", "[channels.inputs]"]
            lines += ['speed = "rpm"', 'load = "%"']
            lines += ["[channels.outputs]", 'temp = "degC"', "[records]"]
            parts = {"train": 0, "validate": 1, "test": 2}
            lines += [f'{part} = ["r{k}.csv"]' for part, k in parts.items()]
            (folder / "engine.toml").write_text("\n".join(lines))
            patch.chdir(folder)
            return folder

        yield make


@pytest.fixture(scope="module")
def remembered():
    """What a command fits or scores a second time, on the same data and with the same
    settings, is what it was the first time; progress is told again. Yields the fits.
    """
    fits: dict[bytes, tuple[list, Any]] = {}
    scores: dict[bytes, Any] = {}

    def fit(train, method, *, validation, progress):
        key = pickle.dumps((train, method, validation))
        if key not in fits:
            rows: list = []
            fits[key] = (
                rows,
                verb(train, method, validation=validation, progress=rows.append),
            )
        rows, found = fits[key]
        for row in rows:
            progress(row)
        return found

    def score(network, parts, *, provenance=None, **options):
        key = pickle.dumps((network, parts, options))
        if key not in scores:
            scores[key] = report(network, parts, provenance=provenance, **options)
        found = scores[key]
        told = {**found.provenance, **(provenance or {})}
        return dataclasses.replace(found, provenance=told)

    from jaxnarx.evaluation import report
    from jaxnarx.shell.identify import verb

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxnarx.shell.identify.verb", fit)
        for user in ("shell.identify", "shell.search.folder", "evaluation"):
            patch.setattr(f"jaxnarx.{user}.report", score)
        yield fits


@pytest.fixture
def typed(capsys):
    """A command line that is run: its exit code, and what it says on both streams."""

    def typed(command: str, line: str):
        code = run([command, *shlex.split(line)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return typed
