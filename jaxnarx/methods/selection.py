"""Settings of term selection."""

import dataclasses
from typing import Literal

from jaxnarx.errors import SpecError


@dataclasses.dataclass(frozen=True)
class ForwardOLS:
    """Forward orthogonal least squares with the error reduction ratio (ERR).

    Chen, Billings and Luo 1989; thesis (5.25), (5.26) and appendix B.
    """

    max_terms: int = 20
    """Largest number of terms."""
    rho: float | int = 0.0
    """Stop when 1 - sum(ERR) falls below this."""
    tau: float | int = 1e-10
    """Pass over a candidate whose orthogonal part falls below this share of its own
    squared norm."""
    tau_absolute: float | int = 0.0
    """The thesis's threshold on the squared norm itself (depends on the data's
    scale).
    """
    constant: Literal["first", "candidate", "after"] = "first"
    """The constant term: chosen before all others, so that the choice is one for the
    centred output; a candidate like others; or added after the choice, as in the
    thesis.
    """

    def __post_init__(self):
        if self.max_terms < 1:
            raise SpecError(
                f"max_terms must be at least 1, got {self.max_terms}", field="max_terms"
            )
        if not 0.0 <= self.rho < 1.0:
            raise SpecError(f"rho must lie in [0, 1), got {self.rho}", field="rho")
        if not 0.0 <= self.tau < 1.0:
            raise SpecError(f"tau must lie in [0, 1), got {self.tau}", field="tau")
        if self.constant not in ("first", "candidate", "after"):
            raise SpecError(
                f"constant must be 'first', 'candidate' or 'after', "
                f"got {self.constant!r}",
                field="constant",
            )
