"""The verdict on a model: its level, the reasons for it, and the rules it comes
from."""

import dataclasses
import math
from typing import Any

from jaxnarx.evaluation.table import number, strict
from jaxnarx.formatting import page

GOOD, LIMITED, UNUSABLE = "good", "usable with limits", "not usable"
AT_MOST, BELOW, AT_LEAST = "at most", "below", "at least"
"""Comparisons of a value with its limit."""

REMEDIES = {
    "bounded": "choose terms by simulation error, lower the degree, or let inputs "
    "enter through filters without output lags, which cannot diverge",
    "unstable": "a model that is stable for certain (`jaxnarx identify DESCRIPTION "
    "--preset ecu` takes no other), or terms chosen by simulation error",
    "cover": "train on records that reach as far",
    "richer": "more regions, other lags, filters, or terms chosen by simulation error",
    "simpler": "fewer terms or regions, or more training data",
    "linear": "a lower degree, or terms chosen by simulation error",
    "test": "name test records that take part in no choice",
    "intervals": "more groups of training records, of the kinds that are met in use",
    "records": "look at these records: channels, sensors, operating range",
}
"""Remedies, by the name that findings carry."""
REMEDIES_AFTER_SEARCH = REMEDIES | {
    "bounded": "training records that reach as far, or linear models",
    "unstable": "`--preset ecu`, which takes only models that are stable for certain",
    "richer": "a larger preset, other inputs, or more training records, above all like "
    "those served worst",
    "simpler": "more training records",
    "linear": "a larger preset, or more training records",
}
"""The same where a search has tried what a user could set."""


@dataclasses.dataclass(frozen=True)
class Reason:
    """One reason: what it makes of the model, and a key of `REMEDIES`."""

    level: str
    text: str
    remedy: str


@dataclasses.dataclass(frozen=True)
class VerdictRule:
    """A rule of the verdict and what came of it: `value` must be `sense` (`"at most"`,
    `"below"`, `"at least"`) `limit`.

    `output` is empty where the rule is about the whole model; `where` names the part,
    the records or the local model. `value` is None where it does not exist, as for the
    error of a run that diverged. `reason` is the verdict's sentence where the rule
    failed; None where another rule has given it.
    """

    name: str
    output: str
    where: str
    value: float | None
    sense: str
    limit: float
    reason: Reason | None = None

    @property
    def passed(self) -> bool | None:
        """Whether the value keeps the limit; None without a value, NaN among them."""
        if self.value is None or math.isnan(self.value):
            return None
        if self.sense == AT_LEAST:
            return self.value >= self.limit
        if self.sense == AT_MOST:
            return self.value <= self.limit
        return self.value < self.limit

    def __str__(self) -> str:
        place = ", ".join(filter(None, (self.name, self.output, self.where)))
        value = "no value" if self.value is None else number(self.value, ".6g")
        return f"{place}: {value}, must be {self.sense} {number(self.limit, '.6g')}"

    _repr_html_ = page

    def explain(self, level: str, text: str, remedy: str) -> "VerdictRule":
        """The rule, with its reason where it failed."""
        if self.passed is not False:
            return self
        return dataclasses.replace(self, reason=Reason(level, text, remedy))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; the reasons are findings of the verdict."""
        values = strict(self) | {"passed": self.passed}
        del values["reason"]
        return values


@dataclasses.dataclass(frozen=True)
class Verdict:
    """`level` is `"good"`, `"usable with limits"` or `"not usable"`; worst reason
    first."""

    level: str
    findings: tuple[Reason, ...]
    praise: str = ""
    remarks: tuple[str, ...] = ()
    """Points to look at, whatever the level."""
    searched: bool = False
    """Whether the model comes from a search."""
    rules: tuple[VerdictRule, ...] = ()
    """All that were applied, whatever came of them."""

    @property
    def usable(self) -> bool:
        """Whether nothing speaks against all use."""
        return self.level != UNUSABLE

    @property
    def remedy(self) -> str:
        """The key of `REMEDIES` for the worst reason; empty where there is none."""
        return self.findings[0].remedy if self.findings else ""

    @property
    def sentence(self) -> str:
        """The verdict with its worst reasons and what would help."""
        head = self.level.capitalize()
        if not self.findings:
            return f"{head}: {self.praise}."
        told = [f.text for f in self.findings[:2]]
        rest = len(self.findings) - len(told)
        more = f"; and {rest} more" if rest else ""
        return f"{head}: {'; '.join(told)}{more}. What helps: {self.helps}."

    @property
    def helps(self) -> str:
        """The measure that helps against the worst reason; empty where there is
        none."""
        known = REMEDIES_AFTER_SEARCH if self.searched else REMEDIES
        return known[self.remedy] if self.findings else ""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        found = [dataclasses.asdict(f) for f in self.findings]
        told = {"level": self.level, "sentence": self.sentence, "findings": found}
        rules = [rule.to_dict() for rule in self.rules]
        return told | {"remarks": list(self.remarks), "rules": rules}
