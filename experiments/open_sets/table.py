"""Comparisons within a row of the open sets, over all rows, and the printed table."""

import math
from typing import Any

Row = dict[str, Any]

SLACK = 1.02
"""How much worse than the best linear output-error model a test may be."""

NOTES = {
    "test": "free run of the test records, RMSE in the unit of the row's set, NRMSE "
    "over the standard deviation of what is scored; all records of a part pooled",
    "start": "a run begins with the measurements before the first scored sample",
    "late": "samples due that one of our models does not predict, for it needs more "
    "history than there is in front of them: its run begins later. Ours and the best "
    "linear of a row are scored over the same samples, those due that both predict; "
    "peers over all due. With more than a tenth of them late: no figure, neither "
    "diverged nor worse",
    "cross-validated": "`free_run` of the leaderboard: NRMSE on training records left "
    "out",
    "to linear": "test NRMSE over that of the best linear output-error model, by part",
    "test over cross-validated": "above one where cross-validation flatters; the first "
    "part of the test",
    "diverged": "records: ours held by their bounds (see `jaxnarx.simulate`), a peer's "
    "not finite or ten training ranges away",
    "peers": "one core each, a fit at a time; see `peers.py` for lags, sizes and what "
    "is chosen how. `rows` of `of` samples were used: of more the trees see every "
    "so many-th, FROLS the first",
    "scored": "every scoring of test records, with the commit of the code",
}


def compared(row: Row) -> Row:
    """What a row says of the choice: beside linear, and beside its own expectation."""
    own, linear = row.get("jaxnarx", {}), row.get("best linear", {})
    if "test" not in own:
        return {}
    found: Row = {}
    if "test" in linear:
        found["to linear"] = {
            part: ratio(errors["nrmse"], linear["test"][part]["nrmse"])
            for part, errors in own["test"].items()
        }
    main = next(iter(own["test"].values()))
    found["test over cross-validated"] = ratio(main["nrmse"], own.get("free_run"))
    return found


def ratio(a: float | None, b: float | None) -> float | None:
    """a / b to four digits; None where one of them is missing."""
    if a is None or not b or not math.isfinite(a / b):
        return None
    return float(f"{a / b:.4g}")


def summary(rows: list[Row], sets: dict[str, Row]) -> Row:
    """What was aimed at: never diverging, never worse than linear; and where it was."""
    own = [row for row in rows if "test" in row.get("jaxnarx", {})]
    beside = [row for row in own if "to linear" in row["compared"]]
    diverged = [_name(row) for row in own if _diverged(row)]
    worse = [_name(row) for row in beside if _worse(row)]
    late = [_name(r) for r in own if any(map(_late, r["jaxnarx"]["test"].values()))]
    return {
        "rows": len(own),
        "failed": {n: held["failed"] for n, held in sets.items() if "failed" in held},
        "late": late,
        "diverged": diverged,
        "beside linear": len(beside),
        "worse than linear": worse,
        "flattered by": {
            _name(row): value
            for row in own
            if (value := row["compared"]["test over cross-validated"]) is not None
            and value > 1
        },
    }


def _name(row: Row) -> str:
    return f"{row['set']} {row['output']}"


def _late(test: Row) -> bool:
    """Whether too many samples are late for a figure."""
    return test["samples"] == 0


def _diverged(row: Row) -> bool:
    tests = row["jaxnarx"]["test"].values()
    return any(
        test["diverged"] or (test["nrmse"] is None and not _late(test))
        for test in tests
    )


def _worse(row: Row) -> bool:
    """Whether a part of the test is worse than linear by more than the slack.

    A missing figure of ours counts as worse unless the linear model has none either, or
    ours is late: only what has been scored over the same samples is compared.
    """
    own, linear = (row[column]["test"] for column in ("jaxnarx", "best linear"))
    return any(
        linear[part]["nrmse"] is not None
        and not _late(test)
        and (test["nrmse"] is None or test["nrmse"] > SLACK * linear[part]["nrmse"])
        for part, test in own.items()
    )


COLUMNS = ("jaxnarx", "best linear", "trees", "SysIdentPy", "SysIdentPy BIC")


def show(rows: list[Row]) -> None:
    """Test NRMSE of every column, a line for every part of every row."""
    heads = "".join(f"{column:>16s}" for column in ("crossval.", *COLUMNS))
    print(f"{'NRMSE':52s}{heads}  family")
    for row in rows:
        own = row.get("jaxnarx", {})
        parts = dict.fromkeys(
            p for c in COLUMNS for p in row.get(c, {}).get("test", ())
        )
        for part in parts:
            cells = [_text(own.get("free_run"))]
            cells += [_cell(row.get(column), part) for column in COLUMNS]
            line = "".join(f"{cell:>16s}" for cell in cells)
            print(f"{_name(row) + ', ' + part:52s}{line}  {own.get('family', '')}")


def _cell(column: Row | None, part: str) -> str:
    if column is None:
        return "-"
    if "failed" in column:
        return "failed"
    test = column["test"][part]
    if test["nrmse"] is None:
        return "late" if _late(test) else "diverged"
    return _text(test["nrmse"]) + ("!" if test["diverged"] else "")


def _text(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.4f}" if value < 1000 else f"{value:.1e}"
