"""A sweep's rows as CSV for spreadsheets, and as lines for people."""

import csv
import io
import json
import statistics
from collections import Counter
from collections.abc import Sequence
from typing import Any

from jaxnarx.files import cell
from jaxnarx.sweep import SweepTable, summary


def sweep_csv(table: SweepTable) -> str:
    """All rows; lists as JSON, what is not there empty, no cell a formula."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([cell(name) for name in table.names])
    for row in table.rows():
        writer.writerow([_cell(value) for value in row.values()])
    return text.getvalue()


def status_lines(table: SweepTable) -> list[str]:
    """Lines that tell how many members ended how."""
    found = summary(table)
    width = max(len(name) for name in found)
    return [f"  {name:<{width}} {number:7d}" for name, number in found.items()]


def best_lines(table: SweepTable, columns: Sequence[str], most: int = 20) -> list[str]:
    """Rows below one another with some of their columns, the first `most`."""
    rows = [[_format_value(row[name]) for name in columns] for row in table.rows()][
        :most
    ]
    lines = [list(columns), *rows]
    widths = [max(len(line[i]) for line in lines) for i in range(len(columns))]
    out = [
        "  " + "  ".join(t.ljust(w) for t, w in zip(line, widths, strict=True)).rstrip()
        for line in lines
    ]
    more = len(table) - len(rows)
    return [*out, *([f"  and {more} more"] if more > 0 else [])]


def calibration_lines(table: SweepTable, outputs: Sequence[str]) -> list[str]:
    """Lines with median errors by numbers of samples: of the fleet's mean, of what was
    calibrated, and which ways were chosen how often."""
    lines, rows = [], list(table.rows())
    for number in dict.fromkeys(row["samples"] for row in rows):
        for name in outputs:
            own = [r for r in rows if r["samples"] == number and r[f"{name}_way"]]
            if own:
                before, after = (
                    statistics.median(r[f"{name}_{kind}"] for r in own)
                    for kind in ("as_is", "free_run")
                )
                ways = Counter(r[f"{name}_way"] for r in own).most_common()
                told = ", ".join(f"{way} {n}" for way, n in ways)
                lines.append(
                    f"  {name}, {number} samples: {before:.3g} -> {after:.3g} ({told})"
                )
    return lines


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        return cell(value)
    if isinstance(value, list):
        return json.dumps(value)
    return "" if value is None else value


def _format_value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "-" if value is None else "".join(c for c in str(value) if c.isprintable())
