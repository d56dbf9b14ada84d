"""Findings of a check of the data: values that read well and survive as JSON."""

import dataclasses
from collections.abc import Iterator
from typing import Any, Literal

from jaxnarx.formatting import page

Severity = Literal["error", "warning", "note"]
SHOWN_FINDINGS = 3
"""Lines of a kind of finding that has more."""
NAMED_CHANNELS = 6
"""Channels that are named of the others."""
_SEVERITY_ORDER: tuple[Severity, ...] = ("error", "warning", "note")


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing worth knowing before a model is fitted.

    `kind` is a fixed word such as "constant" or "spikes"; `channel` and `record` name
    what it concerns, None where it concerns all. `rows` are spans (first, last), both
    included, counted as the record's source counts its rows; `times` the same spans in
    seconds from the beginning of the record. Long lists are cut at 20 spans.
    """

    severity: Severity
    kind: str
    message: str
    channel: str | None = None
    record: str | None = None
    rows: tuple[tuple[int, int], ...] = ()
    times: tuple[tuple[float, float], ...] = ()

    def __str__(self) -> str:
        return f"{self.severity}: {self.message}"

    _repr_html_ = page


@dataclasses.dataclass(frozen=True)
class Findings:
    """Findings of a check, errors first; `is_okay` where none of them is an error."""

    items: tuple[Finding, ...]

    def __post_init__(self):
        ranked = sorted(self.items, key=lambda f: _SEVERITY_ORDER.index(f.severity))
        object.__setattr__(self, "items", tuple(ranked))

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Finding]:
        return iter(self.items)

    @property
    def is_okay(self) -> bool:
        return all(f.severity != "error" for f in self.items)

    def of(self, kind: str) -> list[Finding]:
        """The findings of one kind."""
        return [f for f in self.items if f.kind == kind]

    def to_dict(self) -> dict[str, Any]:
        """Plain types for JSON: `is_okay`, `counts` by severity and the `findings`."""
        return {
            "is_okay": self.is_okay,
            "counts": {s: sum(f.severity == s for f in self) for s in _SEVERITY_ORDER},
            "findings": [
                dataclasses.asdict(f)
                | {"rows": [list(r) for r in f.rows]}
                | {"times": [list(t) for t in f.times]}
                for f in self
            ],
        }

    def __str__(self) -> str:
        """A line each; of a kind that has many the first of some channels, and then how
        many more of which channels."""
        kinds: dict[tuple, list[Finding]] = {}
        for f in self:
            kinds.setdefault((f.severity, f.kind), []).append(f)
        lines = [line for own in kinds.values() for line in _group_lines(own)]
        return "\n".join(lines) or "no findings"

    _repr_html_ = page


def _group_lines(own: list[Finding]) -> list[str]:
    """Lines of the findings of one kind and severity."""
    if len(own) <= SHOWN_FINDINGS + 1:
        return [str(f) for f in own]
    first = {f.channel: n for n, f in reversed(list(enumerate(own)))}
    order = sorted(range(len(own)), key=lambda n: (first[own[n].channel] != n, n))
    shown, rest = order[:SHOWN_FINDINGS], order[SHOWN_FINDINGS:]
    names = list(dict.fromkeys(own[n].channel or "" for n in sorted(rest)))
    of = ", ".join(
        names[:NAMED_CHANNELS]
    ) + f" and {len(names) - NAMED_CHANNELS} others" * (len(names) > NAMED_CHANNELS)
    of = f" of {of}" if any(names) else ""
    more = f"{own[0].severity}: ... and {len(rest)} more ({own[0].kind}{of})"
    return [str(own[n]) for n in shown] + [more]
