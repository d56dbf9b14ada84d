"""The exit code that a report deserves."""

import math
from typing import TYPE_CHECKING

from jaxnarx.errors import SpecError
from jaxnarx.shell.messages import warn

if TYPE_CHECKING:
    from jaxnarx.evaluation import Report


def require_finite(option: str, value: float | None) -> None:
    """SpecError where an option is not a number."""
    if value is not None and not math.isfinite(value):
        raise SpecError(f"--{option.replace('_', '-')} must be a number, got {value}")


def exit_code_of(report: "Report", required: float | None = None) -> int:
    """The exit code: 1 for a model that is not usable, or below the required fit."""
    status = 0
    if not report.verdict.usable:
        warn(f"not usable: {report.verdict.findings[0].text}")
        status = 1
    if required is None:
        return status
    for channel in report.outputs:
        fit = report.pooled(channel.name).fit
        if fit is None or not fit >= required:
            got = "no figure (it diverges)" if fit is None else f"{fit:.1f} %"
            warn(
                f"the free-run fit of {channel.name} on {report.main} is {got}, below "
                f"the required {required:g} %"
            )
            status = 1
    return status
