"""The printed table of the public sets, and errors over the size of the models."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

Row = dict[str, Any]

OURS = ("hidden states", "identify")
ELSEWHERE = ("trees", "SysIdentPy", "SysIdentPy BIC")
"""Columns of `open_sets.json`."""

NOTES = {
    "test": "free run of the test records, RMSE in the unit of the row's set, NRMSE "
    "over the standard deviation of what is scored; all records of a part pooled",
    "start": "hidden states are estimated from the official window of measured samples "
    "before the first scored one (tanks, Silverbox, Wiener-Hammerstein 50, drives 10, "
    "the others 50); NARX models begin with the lags they need, the GRU with inputs "
    "before",
    "hidden states": "structure and pull by the free run on groups of the training "
    "records left out, then trained on all training samples; candidates under `sets`",
    "hidden states, not held": "the same network with its inputs and reported outputs "
    "not held to the ranges of its training; beside the others, never chosen",
    "identify": "`jaxnarx.identify` with preset good",
    "best": "of hidden states and identify the one with the smaller error on groups "
    "left out (`free_run`), not on the test",
    "seeds": "nothing is random in ours and in fastcan; GRU and jax-sysid: mean of the "
    "errors of three seeds, each under `seeds`",
    "operations": "multiplications, divisions and exponentials at a sample",
    "trees, SysIdentPy": "see `open_sets.json`",
    "scored": "every scoring of test records, with the commit of the code",
}


def with_best(row: Row) -> None:
    """Say which of our columns is the best by what was left out."""
    able = [c for c in OURS if row.get(c, {}).get("free_run") is not None]
    row.pop("best", None)
    if able:
        row["best"] = min(able, key=lambda column: row[column]["free_run"])


def lines(row: Row, published: Row, other: Row) -> Iterator[tuple[str, str, Row]]:
    """(part, column, figures) of a row: ours, peers, and what is published."""
    own = row.get("best")
    parts = next((row[c]["test"] for c in OURS if c in row), {})
    for part in parts:
        if own is not None:
            yield part, f"ours, best ({own})", _of(row[own], part)
        for column, held in {**row, **other}.items():
            if isinstance(held, dict) and part in held.get("test", {}):
                name = f"ours, {column}" if column.startswith(OURS) else column
                yield part, name, _of(held, part)
        for figure in published.get(row["set"], []):
            errors = {k: figure.get(k, {}).get(part) for k in ("rmse", "nrmse")}
            if any(value is not None for value in errors.values()):
                yield part, f"{figure['method']} ({figure['certain']})", errors


def _of(column: Row, part: str) -> Row:
    sizes = {key: column.get(key) for key in ("parameters", "operations")}
    return column["test"][part] | sizes | {"seconds": _seconds(column)}


def _seconds(column: Row) -> float | None:
    return column.get("fit_seconds", column.get("seconds"))


def others(rows: list[Row], row: Row) -> Row:
    """The peers' columns of the same row of the open sets."""
    for one in rows:
        if (one["set"], one["output"]) == (row["set"], row["output"]):
            return {column: one[column] for column in ELSEWHERE if column in one}
    return {}


def show(rows: list[Row], published: Row, elsewhere: list[Row]) -> None:
    """Errors, sizes and seconds, a block for every part of every row."""
    heads = ("RMSE", "NRMSE", "parameters", "operations", "seconds")
    print(f"{'':44s}" + "".join(f"{head:>12s}" for head in heads))
    for row in rows:
        before = None
        for part, name, figures in lines(row, published, others(elsewhere, row)):
            if part != before:
                print(f"{row['set']} {row['output']} [{row.get('unit')}], {part}")
                before = part
            keys = ("rmse", "nrmse", "parameters", "operations", "seconds")
            cells = "".join(f"{_text(figures.get(key)):>12s}" for key in keys)
            print(f"  {name:42s}{cells}{' !' * bool(figures.get('diverged'))}")


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


def draw(rows: list[Row], published: Row, path: Path) -> None:
    """Errors of the first part of every row over parameters and over operations.

    Published figures, whose sizes are not known here, are lines.
    """
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    rows = [row for row in rows if any(c in row for c in OURS)]
    if not rows:
        return
    figure, axes = plt.subplots(
        *(len(rows), 2),
        figsize=(10, 2.6 * len(rows)),
        squeeze=False,
        sharey="row",
        layout="constrained",
    )
    for row, pair in zip(rows, axes, strict=True):
        found = list(lines(row, published, {}))
        first = [(name, one) for part, name, one in found if part == found[0][0]]
        for axis, size in zip(pair, ("parameters", "operations"), strict=True):
            _errors(axis, first, size)
            axis.set_xlabel(size)
        part = "" if found[0][0] == "test" else f", {found[0][0]}"
        pair[0].set_title(f"{row['set']} {row['output']}{part}", loc="left", fontsize=9)
        pair[0].set_ylabel(f"RMSE [{row.get('unit')}]")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _errors(axis: Any, found: list[tuple[str, Row]], size: str) -> None:
    """Points with their names; grey lines where the size is not known."""
    axis.set(xscale="log", yscale="log")
    axis.margins(0.35, 0.3)
    for name, one in found:
        # The best stands under its own name, and unheld most lie on one another.
        twice = name.startswith("ours, best") or name.endswith("not held")
        if one.get("rmse") is None or twice:
            continue
        if one.get(size):
            axis.plot(one[size], one["rmse"], "o" if "ours" in name else "s", ms=5)
            axis.annotate(
                name.removeprefix("ours, "),
                (one[size], one["rmse"]),
                xytext=(4, 3),
                textcoords="offset points",
                fontsize=7,
            )
        elif "certain" not in one and "diverged" not in one:
            axis.axhline(one["rmse"], color="0.75", lw=0.8)
            axis.annotate(
                name,
                (0.99, one["rmse"]),
                xycoords=("axes fraction", "data"),
                ha="right",
                fontsize=6,
                color="0.5",
            )
