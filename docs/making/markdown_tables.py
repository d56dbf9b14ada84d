"""Tables in Markdown of recorded results: what their makers share."""

import json
from pathlib import Path
from typing import Any

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
RESULTS = EXPERIMENTS / "benchmarks" / "results"


def loaded(path: Path) -> dict[str, Any]:
    """A recorded result."""
    return json.loads(path.read_text(encoding="utf-8"))


def source(path: Path) -> str:
    """Where figures come from, as a line under their table."""
    content = loaded(path)
    machine, code = content["machine"], content.get("code") or {}
    commit = str(code.get("commit") or "unknown")[:7]
    dirty = " with changes" if code.get("dirty") else ""
    return (
        f"*`{path.relative_to(EXPERIMENTS.parent)}`, {content['date'][:10]}, "
        f"{machine['cpu']}, {machine['cores']} cores, commit {commit}{dirty}; "
        f"`{content['command']}`.*\n"
    )


def table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table; the first column holds words, the others figures."""
    lines = [head, ["---", *["--:"] * (len(head) - 1)], *rows]
    escaped = [[cell.replace("|", r"\|") for cell in line] for line in lines]
    return "".join("| " + " | ".join(line) + " |\n" for line in escaped) + "\n"


def number(value: Any, digits: int = 3) -> str:
    """A figure as it is read, `-` where there is none."""
    if value is None:
        return "–"
    if isinstance(value, int) or abs(value) >= 1e6:
        return f"{value:,.0f}"
    return f"{value:.{digits}g}" if abs(value) < 1000 else f"{value:,.0f}"


def give_or_take(*figures: str) -> str:
    """A figure and its uncertainty, which stay on one line."""
    return "\u00a0±\u00a0".join(figures)
