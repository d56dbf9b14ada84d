"""Settings of term selection."""

from collections.abc import Sequence
from typing import Literal

from jaxnarx.checks import require
from jaxnarx.settings.fields import Chance, Count, NotNegative, Share, settings


@settings
class ForwardOLS:
    """Forward orthogonal least squares with the error reduction ratio (ERR).

    Chen, Billings and Luo 1989; thesis (5.25), (5.26) and appendix B.
    """

    max_terms: Count = 20
    """Largest number of terms."""
    rho: Share = 0.0
    """Stop when 1 - sum(ERR) falls below this."""
    tau: Share = 1e-10
    """Pass over a candidate whose orthogonal part falls below this share of its own
    squared norm."""
    tau_absolute: NotNegative = 0.0
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


@settings
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

    max_terms: Count = 25
    """Largest number of terms at any time, the constant included."""
    f_in: NotNegative | None = None
    """Partial F above which a term enters (thesis: 5 to 5.5; default: see above)."""
    f_out: NotNegative | None = None
    """Partial F below which a term leaves (thesis: 4; default: as `f_in`)."""
    significance: Chance = 0.01
    """Probability with which noise alone reaches the default level."""
    stages: Sequence[int] | None = None
    """Staged search: how many linear, then quadratic, then cubic terms, such as
    2 3 3; default: terms of all degrees at once."""
    exchange: bool = True
    """Swap single terms, at the end, as long as that lowers the squared error."""
    tau: Share = 1e-10
    """Pass over a candidate whose orthogonal part falls below this share of its own
    squared norm."""
    forced: Sequence[str] = ()
    """Terms taken in before any choice, which never leave."""
    forbidden: Sequence[str] = ()
    """Terms that may not be chosen."""

    def __post_init__(self):
        require(
            self.f_in is None or self.f_out is None or self.f_out <= self.f_in,
            "f_out",
            f"f_out must not exceed f_in, got {self.f_out} > {self.f_in}: a term would "
            "leave right after it has entered",
        )
        counts = (0,) if self.stages is None else self.stages
        require(
            0 < len(counts) <= 4 and min(counts) >= 0,
            "stages",
            f"stages must give one to four counts, not negative, got {self.stages}",
        )


@settings
class Backward:
    """Backward elimination by partial F, then exchange of single terms.

    Terms leave, the smallest partial F first, while it is below `f_out` (default: as
    for `StepwiseF`); then a chosen term is swapped for a candidate as long as that
    lowers the squared error. From a pool the elimination starts from `max_terms` terms
    of a forward search by ERR with the constant first: more than are true, because on
    inputs that vary slowly the true terms come late. From a selection it starts there.
    """

    max_terms: Count = 25
    """Terms of the forward search that a pool is first reduced to."""
    f_out: NotNegative | None = None
    """Partial F below which a term leaves."""
    significance: Chance = 0.01
    """Probability with which noise alone reaches the default level."""
    exchange: bool = True
    """Swap single terms as long as that lowers the squared error."""
    tau: Share = 1e-10
    """Pass over a candidate whose orthogonal part falls below this share of its own
    squared norm."""
    forced: Sequence[str] = ()
    """Terms taken in before any choice, which never leave."""
    forbidden: Sequence[str] = ()
    """Terms that may not be chosen."""
