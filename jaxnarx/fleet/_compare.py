"""The verb `compare_records`: whether an engine is still itself."""

import dataclasses
from typing import Any

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Dataset
from jaxnarx.fleet.coefficients import names_of
from jaxnarx.fleet.information import Information
from jaxnarx.fleet.member import know_member, sum_records
from jaxnarx.fleet.population import root_of
from jaxnarx.fleet.prior import FleetPrior
from jaxnarx.formatting import brief, list_names, page
from jaxnarx.solution import RESULTS, Solution

STRONG_LOG_ODDS = 3.0
"""Natural logarithm of the odds from which the answer is clear: 20 to 1."""
NAMED = 5
"""Coefficients that are named as changed."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class EngineChange:
    """Whether two measurements are of one engine.

    `log_odds` is the natural logarithm of how much more likely both are with the same
    coefficients than with coefficients of two engines of the fleet; `changed` are the
    coefficients that differ most, in standard deviations of what is known of them.
    """

    log_odds: float
    changed: dict[str, float]

    @property
    def same(self) -> bool | None:
        """Whether it is still itself; None where the records do not tell."""
        if abs(self.log_odds) < STRONG_LOG_ODDS:
            return None
        return self.log_odds > 0

    def __str__(self) -> str:
        """The answer, and what has changed."""
        said = {True: "still itself", False: "another, or changed", None: "not clear"}
        text = f"EngineChange: {said[self.same]} (log odds {self.log_odds:.3g})"
        if self.same is False:
            text += f"; most by {list_names(list(self.changed), NAMED)}"
        return text

    __repr__, _repr_html_ = brief, page


@guard_arguments
def compare_records(
    prior: FleetPrior, earlier: Dataset, later: Dataset
) -> Solution[EngineChange]:
    """Whether an engine is still itself: records of before, and of months later.

    Compares two hypotheses by the evidence of both records under the population: one
    engine with the same coefficients, and two engines of the fleet (Bayes factor; R. E.
    Kass, A. E. Raftery, Bayes factors, JASA 90, 1995, 773-795). Residuals count as
    coloured as the donors' are. To first order about the population's mean.

    Args:
        prior: What was learnt from the fleet.
        earlier: Records with the channels of its network.
        later: Records of the same engine, or of what is taken for it.

    Returns:
        `value` with `log_odds`, `same` and what has `changed`. Status `too_short` where
        either has no sample that counts.

    Example:
        prior = jnx.fleet.learn({"one": data, "other": data}, network).value
        print(jnx.fleet.compare_records(prior, data[:1], data[1:]).value)
    """
    sums = [sum_records(prior, data) for data in (earlier, later)]
    if not all(np.asarray(s.samples).any() for s in sums):
        text = "no sample counts in one of them"
        return Solution(EngineChange(0.0, {}), RESULTS.too_short, {}, text)
    both = Information(
        *(np.asarray(a) + np.asarray(b) for a, b in zip(*sums, strict=True))
    )
    alone = [_log_evidence(prior, s) for s in sums]
    odds = _log_evidence(prior, both) - sum(alone)
    one, other = (know_member(prior, s) for s in sums)
    spread = np.sqrt(np.diag(one.covariance) + np.diag(other.covariance))
    change = (other.mean - one.mean) / np.maximum(spread, 1e-12)
    names = names_of(prior.coefficients)
    order = np.argsort(-np.abs(change))[:NAMED]
    value = EngineChange(
        float(odds), {names[n]: round(float(change[n]), 2) for n in order.tolist()}
    )
    stats: dict[str, Any] = {"log_odds": value.log_odds, "changed": value.changed}
    return Solution(value, RESULTS.ok, stats, str(value))


def _log_evidence(prior: FleetPrior, sums: Information) -> float:
    """Logarithm of the probability of the records under the population, up to what
    depends on their number alone."""
    precision = np.asarray(prior.population.precision)
    root = root_of(prior.population.covariance)
    gram = root.T @ np.einsum("opq,o->pq", sums.gram, precision) @ root
    right = root.T @ np.einsum("op,o->p", sums.right, precision)
    inner = np.eye(len(gram)) + gram
    square = float(np.asarray(sums.square) @ precision)
    explained = float(right @ np.linalg.solve(inner, right))
    return -0.5 * (square - explained + float(np.linalg.slogdet(inner)[1]))
