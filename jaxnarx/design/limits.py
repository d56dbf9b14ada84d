"""Limits of a test plan: ranges, rates, combinations, predicted outputs."""

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.checks import Number, Pair, positive, require, require_known, span
from jaxnarx.errors import SpecError
from jaxnarx.models import Network

_COMPARISON_PATTERN = re.compile(r"\s*(.+?)\s*([<>])\s*([-+0-9.eE]+)\s*")
NO_DOMAIN = (
    "the network has no domain, so nothing says what it knows: "
    "jnx.confidence.fit_domain(network, data) fits one to the records of its training"
)


@dataclasses.dataclass(frozen=True)
class InputComparison:
    """`speed > 3000`: input, whether above, and the number."""

    column: int
    above: bool
    number: float

    def holds(self, u: Float[np.ndarray, "*rows inputs"]) -> Bool[np.ndarray, "*rows"]:
        """Whether the comparison holds, point by point."""
        x = u[..., self.column]
        return x > self.number if self.above else x < self.number


@dataclasses.dataclass(frozen=True, eq=False)
class PlanLimits:
    """All limits of a plan: inputs in physical units, rates per sample, outputs.

    `forbidden` are combinations, each a conjunction of comparisons. `lowest` and
    `highest` bound the network's outputs, infinite where nothing does.
    """

    low: Float[np.ndarray, " inputs"]
    high: Float[np.ndarray, " inputs"]
    rate: Float[np.ndarray, " inputs"]
    forbidden: tuple[tuple[InputComparison, ...], ...]
    lowest: Float[np.ndarray, " outputs"]
    highest: Float[np.ndarray, " outputs"]

    @property
    def bounds_outputs(self) -> bool:
        """Whether any output has a limit."""
        return bool(np.isfinite(self.lowest).any() or np.isfinite(self.highest).any())

    def allows(self, u: Float[np.ndarray, "*rows inputs"]) -> Bool[np.ndarray, "*rows"]:
        """Whether inputs are none of the forbidden combinations."""
        out = np.zeros(u.shape[:-1], bool)
        for combination in self.forbidden:
            out |= np.logical_and.reduce([c.holds(u) for c in combination])
        return ~out

    def room(
        self,
        y: Float[np.ndarray, "*rows outputs"],
        margin: Float[np.ndarray, "*rows outputs"],
    ) -> Float[np.ndarray, "*rows outputs"]:
        """The room of outputs with a margin around them to their nearest limit,
        negative beyond it; infinite without a limit, negative where not finite."""
        limited = np.isfinite(self.lowest) | np.isfinite(self.highest)
        room = np.minimum(y - self.lowest, self.highest - y) - margin
        return np.where(limited, np.where(np.isnan(room), -np.inf, room), np.inf)


def limits_for(
    network: Network,
    ranges: Mapping[str, Pair] | None,
    rates: Mapping[str, Number] | None,
    forbidden: Sequence[str],
    limits: Mapping[str, Number | Pair] | None,
) -> PlanLimits:
    """The limits asked for, and for what they do not name those of the training."""
    if network.domain is None:
        raise SpecError(NO_DOMAIN, field="network")
    names = network.channels.input_names
    low, high = (np.array(a, float)[: len(names)] for a in (network.low, network.high))
    rate = np.full(len(names), np.inf)
    rate[list(network.domain.inputs)] = np.asarray(network.domain.rate)
    rate = np.where(rate > 0, rate, np.inf)
    for name, pair in (ranges or {}).items():
        i = _input(name, names, "ranges")
        low[i], high[i] = span(pair, "ranges")
        require(
            bool(low[i] < high[i]),
            "ranges",
            f"ranges of {name} must be (low, high) with low < high, got {pair}",
        )
    for name, value in (rates or {}).items():
        i = _input(name, names, "rates")
        rate[i] = positive(value, "rates") * float(network.sample_time)
    return PlanLimits(
        *(low, high, rate),
        tuple(_combination(text, names) for text in forbidden),
        *_bounds(network, limits or {}),
    )


def _input(name: str, names: list[str], field: str) -> int:
    told = f"{field} names {name!r}, which is no input of the network"
    return names.index(require_known(name, names, field, told))


def _combination(text: str, names: list[str]) -> tuple[InputComparison, ...]:
    """`speed > 3000 & load < 5` as comparisons."""
    found = []
    for part in text.split("&"):
        match = _COMPARISON_PATTERN.fullmatch(part)
        number = _number(match[3]) if match else math.nan
        if match is None or not math.isfinite(number):
            raise SpecError(
                "forbidden takes comparisons of inputs with numbers, joined by &, such "
                f"as 'speed > 3000 & load < 5'; got {text!r}",
                field="forbidden",
            )
        column = _input(match[1], names, "forbidden")
        found.append(InputComparison(column, match[2] == ">", number))
    return tuple(found)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _bounds(
    network: Network, limits: Mapping[str, Number | Pair]
) -> tuple[Float[np.ndarray, " outputs"], Float[np.ndarray, " outputs"]]:
    """Lowest and highest value of every output; a single number is the highest."""
    names = network.output_names
    lowest, highest = (np.full(len(names), x) for x in (-np.inf, np.inf))
    for name, given in limits.items():
        told = f"limits names {name!r}, which the network does not compute"
        o = names.index(require_known(name, names, "limits", told))
        low, high = given if isinstance(given, tuple | list) else (-math.inf, given)
        if not low < high:
            raise SpecError(
                f"limits of {name} must be a highest value, or (lowest, highest), got "
                f"{given}",
                field="limits",
            )
        lowest[o], highest[o] = low, high
    return lowest, highest
