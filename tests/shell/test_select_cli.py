"""`jaxnarx identify --select`: every way of choosing terms, and what is refused."""

import json

import numpy as np
import pytest

from jaxnarx.shell.cli import run


@pytest.fixture(scope="module")
def description(tmp_path_factory):
    folder = tmp_path_factory.mktemp("engine")
    rng = np.random.default_rng(3)
    for name, length in (("train", 260), ("test", 120)):
        u = np.repeat(rng.uniform(-1, 1, length // 10 + 1), 10)[:length]
        y = np.zeros(length)
        for t in range(1, length):
            y[t] = 0.8 * y[t - 1] + 0.4 * u[t - 1] - 0.2 * u[t - 1] ** 2
        rows = np.column_stack([u, y + 0.02 * rng.normal(size=length)])
        text = "\n".join(",".join(f"{x:.6g}" for x in row) for row in rows)
        (folder / f"{name}.csv").write_text("u,y\n" + text + "\n")
    path = folder / "engine.toml"
    path.write_text(
        "[data]\nsample_time = 0.1\n[channels.inputs]\nu = 'V'\n"
        "[channels.outputs]\ny = 'mV'\n[records]\ntrain = ['train.csv']\n"
        "test = ['test.csv']\n"
    )
    return path


SMALL = ["--input-lags", "1", "2", "--output-lags", "1", "--terms", "6"]
SHORT = ["--steps", "3", "--horizons", "30", "--window-steps", "3"]


def identify(description, out, *more: str) -> int:
    root = ["--root", str(description.parent)]
    command = ["identify", str(description), *root, *SMALL, *SHORT, *more]
    return run([*command, "--out", str(out)])


SLOW = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    "how",
    [
        pytest.param("stepwise", marks=SLOW),
        pytest.param("backward", marks=SLOW),
        "simulation",
    ],
)
def test_every_choice_ends_in_a_report(description, tmp_path, how, capsys):
    assert identify(description, tmp_path / how, "--select", how) == 0
    said = capsys.readouterr().out
    assert "Choosing up to 6 of 10 terms" in said
    assert ("taken in" in said) == (how == "simulation")
    content = json.loads((tmp_path / how / "report.json").read_text())
    names = content["selection"]["y"]["names"]
    assert {"1", "y[t-1]", "u[t-1]"} <= set(names) and len(names) <= 6


def test_what_does_not_fit_together_is_refused(description, tmp_path, capsys):
    wrong = ["--select", "stepwise", "--constant", "after"]
    assert identify(description, tmp_path / "a", *wrong) == 2
    assert "--constant does not go with --select stepwise" in capsys.readouterr().err
    assert identify(
        description, tmp_path / "b", "--select", "backward", "--significance", "2"
    )
    assert "significance" in capsys.readouterr().err
