"""Tables of thesis chapter 5 as text, with the thesis's own figures beside ours."""

from collections.abc import Mapping, Sequence
from typing import Any

THESIS = {
    "TRQ": {
        "CORR": {"r2": 67.6, "cp": 15, "fpe": 8750},
        "ERR": {"r2": 66.8, "cp": 15, "fpe": 8770},
    },
    "AFR": {
        "CORR": {"r2": 73.8, "cp": 11, "fpe": 1361},
        "ERR": {"r2": 86.5, "cp": 11, "fpe": 696},
    },
}
"""Table 5.5. Another engine, other units: FPE and Cp cannot be compared with ours."""

MODES = ("one_step", "free_run")
PARTS = ("identification", "unseen")


def f_table(rounds: Sequence[Mapping[str, float]], limit: int = 7) -> str:
    """Table 5.2: partial F of every term in the model after each round.

    Columns are terms in order of entry, the constant and its round left out; an empty
    place right of the first is a term that is not in the model.
    """
    rows = [{k: f for k, f in row.items() if k != "1"} for row in rounds]
    shown = [row for row in rows if row][:limit]
    names = list(dict.fromkeys(name for row in shown for name in row))
    lines = ["round" + "".join(f"{f'Reg{i + 1}':>11}" for i in range(len(names)))]
    for i, row in enumerate(shown):
        cells = [f"{row[name]:.5g}" if name in row else "" for name in names]
        lines.append(f"{i + 1:5d}" + "".join(f"{cell:>11}" for cell in cells))
    lines += [f"  Reg{i + 1} = {name}" for i, name in enumerate(names)]
    return "\n".join(lines)


def term_table(models: Mapping[str, Mapping[str, Any]]) -> str:
    """Tables 5.3 and 5.4: terms and coefficients in the units of the channels."""
    lines = []
    for name, model in models.items():
        lines.append(name)
        lines += [f"  {value:12.5g}  {term}" for term, value in model["terms"].items()]
    return "\n".join(lines)


def quality_table(output: str, models: Mapping[str, Mapping[str, Any]]) -> str:
    """Table 5.5: quality on both records, one step ahead and in the free run."""
    width = max(map(len, models)) + 2
    lines = []
    for part in PARTS:
        heads = ("one step", "free run", *(["thesis"] if part == "unseen" else []))
        below = f"{'R2 %':>9}{'Cp':>9}{'FPE':>9}"
        lines.append(f"{part:<{width + 6}}" + "".join(f"{h:>27}" for h in heads))
        lines.append(f"{'':<{width}}{'terms':>6}{below * len(heads)}")
        for name, model in models.items():
            cells = [_cells(model["quality"][part][mode]) for mode in MODES]
            printed = THESIS[output].get(name)
            cells += [_cells(printed)] if printed and part == "unseen" else []
            size = f"{len(model['terms']):6d}"
            lines.append(f"{name:<{width}}{size}{''.join(cells)}")
    return "\n".join(lines)


def _cells(row: Mapping[str, Any]) -> str:
    """R2, with a star for a run that was held at its bounds too often, Cp and FPE."""
    r2 = f"{row['r2']:.2f}" + ("*" if row.get("diverged") else "")
    return f"{r2:>9}{row['cp']:9.0f}{row['fpe']:9.0f}"


def spread_table(methods: Mapping[str, Mapping[str, Any]]) -> str:
    """Unseen R2 over seeds: median and extremes, and how many free runs diverged."""
    width = max(map(len, methods)) + 2
    head = f"{'':<{width}}{'terms':>6}{'one step: least, median':>25}"
    lines = [head + f"{'free run: least, median':>25}{'diverged':>10}"]
    for name, row in methods.items():
        cells = [
            f"{row[mode]['least']:13.2f}{row[mode]['median']:12.2f}" for mode in MODES
        ]
        size = f"{row['terms_median']:6.0f}"
        diverged = f"{row['diverged']:10d}"
        lines.append(f"{name:<{width}}{size}{''.join(cells)}{diverged}")
    return "\n".join(lines)
