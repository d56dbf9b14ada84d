"""What a look at the data turned up: values that read well and survive as JSON."""

import dataclasses
from collections.abc import Iterator
from typing import Any, Literal

from jaxnarx.shown import page

Severity = Literal["error", "warning", "note"]
_ORDER: tuple[Severity, ...] = ("error", "warning", "note")


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
    """Findings, errors first. `is_okay` while none of them is an error."""

    items: tuple[Finding, ...]

    def __post_init__(self):
        ranked = sorted(self.items, key=lambda f: _ORDER.index(f.severity))
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
            "counts": {s: sum(f.severity == s for f in self) for s in _ORDER},
            "findings": [
                dataclasses.asdict(f)
                | {"rows": [list(r) for r in f.rows]}
                | {"times": [list(t) for t in f.times]}
                for f in self
            ],
        }

    def __str__(self) -> str:
        """A line each; two at most where a kind strikes a channel in many records."""
        groups: dict[tuple, list[Finding]] = {}
        for f in self:
            groups.setdefault((f.severity, f.kind, f.channel), []).append(f)
        lines = []
        for (severity, kind, channel), members in groups.items():
            lines += [str(f) for f in members[:2]]
            if members[2:]:
                of = f" of {channel}" if channel else ""
                lines.append(
                    f"{severity}: ... and {len(members) - 2} more ({kind}{of})"
                )
        return "\n".join(lines) or "no findings"

    _repr_html_ = page
