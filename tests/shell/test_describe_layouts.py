"""Files laid out as published data sets are: what `describe` writes is read, checked
and ready to be identified without an edit."""

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from jaxnarx.data import check, groups, read_split, suggest_lags
from jaxnarx.shell.cli import run

ROWS = 240
STEP = ["--sample-time", "0.1"]


def record(seed: int, rows: int = ROWS, inputs: int = 1) -> tuple[np.ndarray, ...]:
    """Inputs that move smoothly, and what they do."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(rows, inputs))
    for t in range(1, rows):
        u[t] = 0.8 * u[t - 1] + u[t]
    y = np.zeros(rows)
    for t in range(1, rows):
        y[t] = 0.7 * y[t - 1] + 0.2 * u[t - 1].sum()
    return u, y + 0.01 * rng.normal(size=rows)


def csv(table: dict[str, np.ndarray], name: str = "a.csv", sep: str = ",") -> None:
    rows = max(map(len, table.values()))
    lines = [sep.join(table)]
    for n in range(rows):
        cells = (f"{x[n]:.9g}" if n < len(x) else "" for x in table.values())
        lines.append(sep.join(cells))
    Path(name).write_text("\n".join(lines) + "\n")


def pair(u: str, y: str, more: Callable | None = None, **options) -> Callable:
    """One file with an input and an output by these names."""

    def write() -> None:
        x, out = record(0)
        csv((more(x[:, 0], out) if more else {}) | {u: x[:, 0], y: out}, **options)

    return write


def numbered(names: tuple[str, str], count: int, first: int = 1, grow: int = 0):
    """An input and an output for each number, as columns of one file."""

    def table() -> dict[str, np.ndarray]:
        own = {n: record(n, ROWS + grow * n) for n in range(first, first + count)}
        columns = {names[0].replace("#", str(n)): u[:, 0] for n, (u, _) in own.items()}
        return columns | {names[1].replace("#", str(n)): y for n, (_, y) in own.items()}

    return table


def matrices() -> None:
    """`m0` to `m5`, each a matrix of two inputs and an output."""
    runs = [record(n, ROWS + n, inputs=2) for n in range(6)]
    np.savez("a.npz", **{f"m{n}": np.column_stack(r) for n, r in enumerate(runs)})  # pyright: ignore


def halves() -> None:
    """Estimation and validation data side by side, as those of the cascaded tanks."""
    (u, y), (v, z) = record(0), record(1)
    csv({"uEst": u[:, 0], "uVal": v[:, 0], "yEst": y, "yVal": z})


def stepping() -> None:
    u, y = record(0)
    csv({"valve": np.repeat(u[::20, 0], 20), "x1": u[:, 0], "quantised": _coarse(y)})


def _coarse(y: np.ndarray) -> np.ndarray:
    slow = np.convolve(y, np.ones(40) / 40, "same")
    return np.round(slow / 0.2) * 0.2


def three() -> None:
    for n in range(3):
        u, y = record(n)
        csv({"time": 0.1 * np.arange(ROWS), "u": u[:, 0], "y": y}, f"run{n}.csv")


def engine() -> None:
    rng = np.random.default_rng(0)
    u, y = record(0, inputs=2)
    table = {"time": 0.1 * np.arange(ROWS), "speed": 1500 + 300 * u[:, 0]}
    table |= {"torque": 100 + 20 * u[:, 1], "T_intake": 30 + rng.normal(size=ROWS)}
    csv(table | {"NOx": 300 + 50 * y})


LAYOUTS: dict[str, tuple[Callable, list[str], dict[str, list[str]], int]] = {
    # writes, options, channels, records
    "u, y": (pair("u", "y"), STEP, {"inputs": ["u"], "outputs": ["y"]}, 2),
    "y before u": (
        lambda: csv({"y": record(0)[1], "u": record(0)[0][:, 0]}),
        STEP,
        {"inputs": ["u"], "outputs": ["y"]},
        2,
    ),
    "u1, u2, y1": (
        lambda: csv(
            {
                "u1": record(0)[0][:, 0],
                "u2": record(1)[0][:, 0],
                "y1": record(0)[1],
            }
        ),
        STEP,
        {"inputs": ["u1", "u2"], "outputs": ["y1"]},
        2,
    ),
    "input, output": (
        pair("input", "output"),
        STEP,
        {"inputs": ["input"], "outputs": ["output"]},
        2,
    ),
    "gas furnace": (
        pair("InputGasRate", "OutputCO2"),
        STEP,
        {"inputs": ["InputGasRate"], "outputs": ["OutputCO2"]},
        2,
    ),
    "one remaining": (
        pair("InputGasRate", "CO-ish"),
        STEP,
        {"inputs": ["InputGasRate"], "outputs": ["CO-ish"]},
        2,
    ),
    "no name says": (
        pair("V1", "V2"),
        STEP,
        {"inputs": ["V1"], "outputs": ["V2"]},
        2,
    ),
    "semicolons": (pair("u", "y", sep=";"), STEP, {"inputs": ["u"]}, 2),
    "tabs": (pair("u", "y", sep="\t", name="a.txt"), STEP, {"inputs": ["u"]}, 2),
    "ts counts": (
        pair("u", "y", lambda u, y: {"ts": 1.0 + np.arange(ROWS)}),
        [],
        {"inputs": ["u"], "outputs": ["y"]},
        2,
    ),
    "t_s": (
        pair("u", "y", lambda u, y: {"t_s": 0.1 * np.arange(ROWS)}),
        [],
        {"inputs": ["u"], "outputs": ["y"]},
        2,
    ),
    "row numbers": (
        pair("u", "y", lambda u, y: {"k": 1.0 * np.arange(ROWS)}),
        STEP,
        {"inputs": ["u"], "outputs": ["y"]},
        2,
    ),
    "quantised sensor": (
        stepping,
        STEP,
        {"inputs": ["valve"], "outputs": ["x1", "quantised"]},
        2,
    ),
    "no header": (
        lambda: np.savetxt("a.csv", np.column_stack(record(0)), delimiter=","),
        [*STEP, "--columns", "u", "y"],
        {"inputs": ["u"], "outputs": ["y"]},
        2,
    ),
    "estimation and validation": (
        halves,
        STEP,
        {"inputs": ["u"], "outputs": ["y"]},
        2,
    ),
    "numbered, one file": (
        lambda: csv(numbered(("Input#", "Output#"), 6)()),
        STEP,
        {"inputs": ["Input"], "outputs": ["Output"]},
        6,
    ),
    "numbered, other lengths": (
        lambda: csv(numbered(("Input#", "Output#"), 5, grow=10)()),
        STEP,
        {"inputs": ["Input"], "outputs": ["Output"]},
        5,
    ),
    "numbered, npz": (
        lambda: np.savez("a.npz", **numbered(("u_#", "y_#"), 5, 0, 7)()),  # pyright: ignore
        STEP,
        {"inputs": ["u"], "outputs": ["y"]},
        5,
    ),
    "matrices": (matrices, STEP, {"inputs": ["m_1"]}, 6),
    "three runs": (three, [], {"inputs": ["u"], "outputs": ["y"]}, 3),
    "an engine": (
        engine,
        ["--outputs", "NOx"],
        {"inputs": ["speed", "torque", "T_intake"], "outputs": ["NOx"]},
        2,
    ),
}


@pytest.mark.parametrize("kind", LAYOUTS)
def test_what_is_written_serves_without_an_edit(kind, tmp_path, monkeypatch, capsys):
    write, options, channels, records = LAYOUTS[kind]
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("JAXNARX_DATA", raising=False)
    Path("data").mkdir()
    monkeypatch.chdir("data")
    write()
    monkeypatch.chdir(tmp_path)
    # whole paths: variables are read by a process that stays where it began
    out = str(tmp_path / "engine.toml")
    words = ["describe", str(tmp_path / "data"), "--out", out, *options]
    assert run(words) == 0, capsys.readouterr().err
    table = tomllib.loads(Path(out).read_text("utf-8"))
    for role, names in channels.items():
        assert list(table["channels"][role]) == names
    split = read_split(out)
    assert len(split.all) == records and split.train is not None
    assert split.test is not None
    assert check(split.train).is_okay
    assert len(groups(split.train)) >= 2 and suggest_lags(split.train).input_lags


def test_one_long_record_is_divided_with_a_pause(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pair("u", "y")()
    assert run(["describe", "a.csv", *STEP]) == 0
    text = Path("engine.toml").read_text()
    assert 'train = ["a.csv @ 0:16.8"]' in text and 'test = ["a.csv @ 18:"]' in text


def test_what_is_left_out_is_named_with_the_option_that_adds_it(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    pair("u", "y", lambda u, y: {"copy": 2 * u, "still": 0 * u})()
    assert run(["describe", "a.csv", *STEP]) == 0
    (line,) = [
        own
        for own in capsys.readouterr().out.splitlines()
        if own.startswith("left out:")
    ]
    assert line.startswith("left out: still, u;") and "--inputs copy still" in line


def test_a_record_in_another_unit_has_a_comment(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for n in range(6):
        u, y = record(n)
        csv({"u": u[:, 0] * (60 if n == 2 else 1), "y": y}, f"run{n}.csv")
    assert run(["describe", ".", *STEP]) == 0
    assert "warning: u in run2.csv goes from" in capsys.readouterr().out
    assert "# look at this record: u in run2.csv" in Path("engine.toml").read_text()


def test_some_of_the_numbers_are_chosen(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    csv(numbered(("Input#", "Output#"), 6)())
    assert run(["describe", "a.csv", *STEP]) == 0
    split = read_split("engine.toml")
    assert split.train is not None
    assert split.train.names == [f"a #{n}" for n in (1, 2, 3, 4, 6)]
    text = Path("engine.toml").read_text()
    Path("b.toml").write_text(text.replace("#5", "#9"))
    with pytest.raises(Exception, match="no columns numbered '9'"):
        read_split("b.toml")
    Path("b.toml").write_text(text.replace("Output#", "Exit#"))
    with pytest.raises(Exception, match="no number in place of # makes columns"):
        read_split("b.toml")
    Path("b.toml").write_text(text.replace("#5", "#4"))
    with pytest.raises(Exception, match="may serve one part only"):
        read_split("b.toml")
