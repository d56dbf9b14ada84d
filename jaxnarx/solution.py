"""The result of every verb, and the one table of statuses."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Generic, TypeVar, cast

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from jaxnarx.errors import JaxnarxError
from jaxnarx.formatting import page

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

SINGLE_PRECISION_NOTE = (
    "computed in float32, so that normal equations keep three to four digits; for more "
    "give float64 data and switch jax_enable_x64 on"
)
"""Note of verbs that estimate on data in single precision."""


class RESULTS(eqx.Enumeration):
    """Statuses of a `Solution`. The first four count as fine, see `is_okay`."""

    ok = "Converged or complete."
    budget_spent = "Steps or time used up; the best so far is returned."
    no_improvement = "Stopped because validation or the criterion no longer improved."
    pool_exhausted = "No further candidate qualifies."
    stalled = "No step decreased the loss, and damping is at its limit."
    start_diverged = "The free run of the starting model leaves its bounds."
    diverged = "The free run leaves its bounds."
    unidentifiable = "The data do not determine these parameters."
    nonfinite_data = "The data hold values that are not finite."
    too_short = "There are too few samples."
    crashed = "The computation failed."
    not_run = "The computation was not started."
    infeasible = "No values keep all limits."


STATUS_NAMES: tuple[str, ...] = (
    "ok",
    "budget_spent",
    "no_improvement",
    "pool_exhausted",
    "stalled",
    "start_diverged",
    "diverged",
    "unidentifiable",
    "nonfinite_data",
    "too_short",
    "crashed",
    "not_run",
    "infeasible",
)
OKAY_STATUSES = 4
"""Number of leading statuses that are informative ends rather than failures."""


def code(status: RESULTS) -> Any:
    """The integer code of a status, an array under a transform."""
    return status._value


class Solution(eqx.Module, Generic[T]):
    """Result of a verb: the value, how it ended, and figures about the way there.

    `stats` is a dictionary of arrays and plain numbers, without solver internals.
    `detail` is one sentence for people; it is made on the host and empty in batches.
    """

    value: T
    status: RESULTS
    stats: dict[str, Any]
    detail: str = eqx.field(static=True, default="")

    def __str__(self) -> str:
        """Tell how it ended, then the value as it prints, then figures about the
        way."""
        if isinstance(code(self.status), Tracer):
            return repr(self)
        parts = [_describe_ending(self), str(self.value), _figures(self.stats)]
        return "\n".join(part for part in parts if part)

    _repr_html_ = page

    @property
    def is_okay(self) -> Any:
        """True where the status is an informative end rather than a failure."""
        status = code(self.status)
        if isinstance(status, Tracer):
            return status < OKAY_STATUSES
        okay = np.asarray(status) < OKAY_STATUSES
        return bool(okay) if okay.ndim == 0 else jax.device_put(okay)

    @property
    def status_name(self) -> str:
        """The status as text, `"budget_spent"`; for a single result."""
        return STATUS_NAMES[int(code(self.status))]

    @property
    def channel(self) -> str | None:
        """Channel the status speaks of, where it speaks of one."""
        return self.stats.get("channel")

    @property
    def row(self) -> int | None:
        """Zero-based data row the status speaks of."""
        return self.stats.get("row")

    @property
    def time(self) -> float | None:
        """Time of `row` in its record [s]."""
        return self.stats.get("time")

    @property
    def first_bad_step(self) -> int | None:
        """First sample at which the feedback bound acted."""
        return self.stats.get("first_bad_step")

    @property
    def cond(self) -> Any:
        """Condition number of the scaled regressors, where one was computed."""
        return self.stats.get("cond")

    @property
    def rank(self) -> Any:
        """Numerical rank of the regressors, where one was computed."""
        return self.stats.get("rank")

    def raise_for_status(self) -> "Solution[T]":
        """Return the solution, or raise `JaxnarxError` where the status is a
        failure.
        """
        if not np.all(self.is_okay):
            text = self.detail or str(RESULTS[self.status])
            raise JaxnarxError(f"{self.status_name}: {text}")
        return self


def tell_precision(verb: F) -> F:
    """A verb that estimates, whose solution tells where it did so in single precision.

    Its `stats` then have `precision`, "float32", and `detail` says what that costs.
    """

    @functools.wraps(verb)
    def call(*args: Any, **kwargs: Any) -> Solution:
        solution = verb(*args, **kwargs)
        told = "precision" in solution.stats  # by a call of the verb inside of this one
        if told or solution.value.gain.dtype != np.float32:
            return solution
        stats = solution.stats | {"precision": "float32"}
        detail = "; ".join(
            text for text in (solution.detail, SINGLE_PRECISION_NOTE) if text
        )
        return dataclasses.replace(solution, stats=stats, detail=detail)

    return cast(F, call)


def _describe_ending(solution: Solution) -> str:
    """Status and detail; of a batch, how many members have which."""
    codes = np.asarray(code(solution.status))
    if codes.ndim:
        count = np.bincount(codes.ravel(), minlength=len(STATUS_NAMES))
        return ", ".join(
            f"{n} {name}" for n, name in zip(count, STATUS_NAMES, strict=True) if n
        )
    why = solution.detail or str(RESULTS[solution.status])
    return f"{solution.status_name}: {why}"


def _figures(stats: dict[str, Any]) -> str:
    """Single figures as they are, of arrays their sizes."""
    told = []
    for name, value in stats.items():
        size = np.shape(value) if isinstance(value, np.ndarray | jax.Array) else None
        if isinstance(value, float) or size == ():
            told.append(f"{name} {float(value):.6g}")
        elif isinstance(value, int | str):
            told.append(f"{name} {value}")
        elif size is not None:
            told.append(f"{name} ({', '.join(map(str, size))})")
        else:
            told.append(f"{name} ...")
    return f"stats: {', '.join(told)}" if told else ""
