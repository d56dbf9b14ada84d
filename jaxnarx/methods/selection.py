"""Settings of term selection."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

from jaxnarx.checks import whole
from jaxnarx.errors import SpecError


def _texts(method: object, *fields: str) -> None:
    """Make tuples of the texts in `fields`; one text alone counts as one term."""
    for field in fields:
        value = getattr(method, field)
        terms = (value,) if isinstance(value, str) else tuple(value)
        object.__setattr__(method, field, terms)


def _share(value: float, field: str) -> None:
    if not 0.0 <= value < 1.0:
        raise SpecError(f"{field} must lie in [0, 1), got {value}", field=field)


def _levels(method: object) -> None:
    for field in ("f_in", "f_out"):
        value = getattr(method, field, None)
        if value is not None and not value >= 0:
            raise SpecError(f"{field} must not be negative, got {value}", field=field)
    significance = getattr(method, "significance")  # noqa: B009
    if not 0.0 < significance < 1.0:
        raise SpecError(
            f"significance must lie between 0 and 1, got {significance}",
            field="significance",
        )


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
    forced: Sequence[str] = ()
    """Terms taken in before any choice, such as "speed[t-1]*load[t]"."""
    forbidden: Sequence[str] = ()
    """Terms that may not be chosen."""

    def __post_init__(self):
        _texts(self, "forced", "forbidden")
        whole(self.max_terms, "max_terms")
        _share(self.rho, "rho")
        _share(self.tau, "tau")
        if self.constant not in ("first", "candidate", "after"):
            raise SpecError(
                f"constant must be 'first', 'candidate' or 'after', "
                f"got {self.constant!r}",
                field="constant",
            )


@dataclasses.dataclass(frozen=True)
class StepwiseF:
    """Stepwise regression: entry by correlation, entry and removal by partial F.

    The constant is in the model from the start. The candidate with the largest
    correlation with the residual enters if its partial F is above `f_in`; then terms
    leave while the smallest partial F is below `f_out`, for good. Thesis (5.5) to
    (5.24) and appendix A. In a search over thousands of candidates the largest F of
    noise is far above the table value of about 4: the default level is the one that the
    largest F of all candidates exceeds by chance with probability `significance`
    (Bonferroni), the quantile 1 - significance / candidates of F(1, N - max_terms).
    A search that takes in one term at a time stops where only several together would
    help; `Backward`, which starts from more terms, does not.
    """

    max_terms: int = 25
    """Largest number of terms at any time, the constant included."""
    f_in: float | int | None = None
    """Partial F above which a term enters (thesis: 5 to 5.5; default: see above)."""
    f_out: float | int | None = None
    """Partial F below which a term leaves (thesis: 4; default: as `f_in`)."""
    significance: float | int = 0.01
    """Probability with which noise alone reaches the default level."""
    stages: Sequence[int] | None = None
    """Staged search: how many linear, then quadratic, then cubic terms, such as
    2 3 3; default: terms of all degrees at once."""
    exchange: bool = True
    """Swap single terms, at the end, as long as that lowers the squared error."""
    tau: float | int = 1e-10
    """Pass over a candidate whose orthogonal part falls below this share of its own
    squared norm."""
    forced: Sequence[str] = ()
    """Terms taken in before any choice, which never leave."""
    forbidden: Sequence[str] = ()
    """Terms that may not be chosen."""

    def __post_init__(self):
        _texts(self, "forced", "forbidden")
        whole(self.max_terms, "max_terms")
        _share(self.tau, "tau")
        _levels(self)
        if self.f_in is not None and self.f_out is not None and self.f_out > self.f_in:
            raise SpecError(
                f"f_out must not exceed f_in, got {self.f_out} > {self.f_in}: a term "
                "would leave right after it has entered",
                field="f_out",
            )
        if self.stages is not None:
            object.__setattr__(self, "stages", tuple(self.stages))
            if not self.stages or min(self.stages) < 0 or len(self.stages) > 4:
                raise SpecError(
                    "stages must give one to four counts, not negative, got "
                    f"{self.stages}",
                    field="stages",
                )


@dataclasses.dataclass(frozen=True)
class Backward:
    """Backward elimination by partial F, then exchange of single terms.

    Terms leave, the smallest partial F first, while it is below `f_out` (default: as
    for `StepwiseF`); then a chosen term is swapped for a candidate as long as that
    lowers the squared error. From a pool the elimination starts from `max_terms` terms
    of a forward search by ERR with the constant first: more than are true, because on
    inputs that vary slowly the true terms come late. From a selection it starts there.
    """

    max_terms: int = 25
    """Terms of the forward search that a pool is first reduced to."""
    f_out: float | int | None = None
    """Partial F below which a term leaves."""
    significance: float | int = 0.01
    """Probability with which noise alone reaches the default level."""
    exchange: bool = True
    """Swap single terms as long as that lowers the squared error."""
    tau: float | int = 1e-10
    """Pass over a candidate whose orthogonal part falls below this share of its own
    squared norm."""
    forced: Sequence[str] = ()
    """Terms taken in before any choice, which never leave."""
    forbidden: Sequence[str] = ()
    """Terms that may not be chosen."""

    def __post_init__(self):
        _texts(self, "forced", "forbidden")
        whole(self.max_terms, "max_terms")
        _share(self.tau, "tau")
        _levels(self)
