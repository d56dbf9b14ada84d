"""The exit code that a report deserves."""

import math
from typing import TYPE_CHECKING

from jaxnarx.errors import SpecError
from jaxnarx.shell.messages import warn

if TYPE_CHECKING:
    from jaxnarx.evaluation import Report, VerdictRule


def require_finite(option: str, value: float | None) -> None:
    """SpecError where an option is not a number."""
    if value is not None and not math.isfinite(value):
        raise SpecError(f"--{option.replace('_', '-')} must be a number, got {value}")


def required_rules(
    report: "Report", required: float | None
) -> tuple["VerdictRule", ...]:
    """The rules that the pooled free-run fit of every output is as required [%]."""
    from jaxnarx.evaluation import AT_LEAST, VerdictRule

    if required is None:
        return ()
    fits = {
        channel.name: report.pooled_row(channel.name).fit for channel in report.outputs
    }
    return tuple(
        VerdictRule("required fit %", output, report.main, fit, AT_LEAST, required)
        for output, fit in fits.items()
    )


def exit_code_of(report: "Report", required: float | None = None) -> int:
    """The exit code: 1 for a model that is not usable, or below the required fit."""
    status = 0
    if not report.verdict.usable:
        warn(f"not usable: {report.verdict.findings[0].text}")
        status = 1
    for rule in required_rules(report, required):
        if not rule.passed:
            fit = rule.value
            got = "no figure (it diverges)" if fit is None else f"{fit:.1f} %"
            warn(
                f"the free-run fit of {rule.output} on {rule.where} is {got}, below "
                f"the required {rule.limit:g} %"
            )
            status = 1
    return status
