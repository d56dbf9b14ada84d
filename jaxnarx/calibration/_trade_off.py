"""The verb `trade_off`: what a limit costs."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import Progress
from jaxnarx.calibration._optimise import optimise
from jaxnarx.calibration.result import Calibration
from jaxnarx.checks import whole
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.settings import Calibratable, CalibrationSearch, CycleLimit, Measure
from jaxnarx.solution import Solution


@guard_arguments
def trade_off(
    plant: Any,
    cycle: Dataset,
    maps: Mapping[str, Calibratable],
    objective: Sequence[Measure],
    limits: Sequence[CycleLimit],
    numbers: Sequence[float | int],
    *,
    which: int = 0,
    search: CalibrationSearch | None = None,
    every: int = 1,
    progress: Progress | None = None,
) -> dict[float, Solution[Calibration]]:
    """Calibrations for several numbers of one limit: the Pareto front of the two.

    One after the other, each begun with the maps of the one before. All are measured by
    the same calibration to begin with.

    Args:
        plant, cycle, maps, objective, limits, search, every: As for `optimise`.
        numbers: Those that the limit is given, in this order.
        which: The limit, counted from zero.
        progress: As for `optimise`, with the `number` beside the others.

    Returns:
        The solutions of `optimise` by number.

    Example:
        free = {"a": jnx.calibration.Calibratable(over=("time",), size=(4,))}
        wanted = [jnx.calibration.Measure("y ** 2")]
        limit = jnx.calibration.CycleLimit(jnx.calibration.Measure("y"), at_most=1.0)
        front = jnx.calibration.trade_off(network, data, free, wanted, [limit], [1.0])
        print({n: found.value.objective[0].value for n, found in front.items()})
    """
    whole(which, "which", 0)
    if which >= len(limits):
        raise SpecError(
            f"which must be one of {len(limits)} limits, got {which}", field="which"
        )
    found: dict[float, Solution[Calibration]] = {}
    begin: Calibration | None = None
    for number in numbers:
        one = limits[which]
        field = "at_most" if one.sign > 0 else "at_least"
        several = list(limits)
        several[which] = dataclasses.replace(one, **{field: number})

        def tell(event: dict[str, Any], number: float = number) -> None:
            if progress is not None:
                progress({**event, "number": number})

        given = plant, cycle, maps, objective, several
        found[float(number)] = optimise(
            *given, search=search, every=every, begin=begin, progress=tell
        )
        if found[float(number)].is_okay:
            begin = found[float(number)].value
    return found
