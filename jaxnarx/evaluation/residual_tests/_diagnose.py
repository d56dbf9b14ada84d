"""The verb `diagnose`: do the one-step residuals let one believe the model?"""

from collections.abc import Iterator, Sequence
from typing import Any, Literal

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Batch, Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.evaluation.gain_signs import check_gains
from jaxnarx.evaluation.residual_tests.coefficients import (
    coefficients,
    error_reduction,
    influences,
)
from jaxnarx.evaluation.residual_tests.correlations import (
    autocorrelation,
    changing_variance,
    higher_order,
    input_correlation,
    normal_scores_of_squares,
    output_product,
)
from jaxnarx.evaluation.residual_tests.diagnostics import (
    Diagnostics,
    OutputDiagnostics,
)
from jaxnarx.evaluation.residual_tests.lag_tests import LagTest
from jaxnarx.evaluation.residual_tests.one_step import OneStep, one_step, usable_inputs
from jaxnarx.evaluation.residual_tests.operating_point import (
    OperatingPoint,
    bin_by_operating_point,
)
from jaxnarx.evaluation.residual_tests.scalar_tests import (
    ljung_box,
    mean_test,
    normality,
    runs_test,
)
from jaxnarx.models import Network
from jaxnarx.regressors import Variables, parse_variable, row_columns, variable_names
from jaxnarx.simulation import Prepared, Trajectories, predict, stack_batch
from jaxnarx.solution import RESULTS, Solution

SPARE_SAMPLES = 10
"""Samples needed beside those for lags and parameters."""


@guard_arguments
def diagnose(
    network: Network,
    data: Dataset | Prepared,
    *,
    lags: int = 20,
    level: float = 0.05,
    selection: Any = None,
    over: Sequence[str] = (),
    estimated: Literal["global", "local", "no"] | None = None,
    predicted: Trajectories | Solution[Trajectories] | None = None,
) -> Solution[Diagnostics]:
    """Test the one-step residuals of every output; see `Diagnostics`.

    Correlations are taken within records and between valid samples; their bounds are
    wrong with probability `level`, if the model is right and its noise independent with
    one variance.

    The status is `too_short` where an output has too few samples for a test; it is left
    out, and `detail` says so.

    Args:
        network: The model.
        data: Records with its channels, at its sample time.
        lags: Samples over which correlations are taken.
        level: Probability that a bound is wrong.
        selection: Gives each term's ERR.
        over: Variables of the operating point, `"speed[t]"` (default: those of the
            scheduling, else the inputs).
        estimated: How the coefficients follow from these data (see `OneStep`); by
            default it is found out.
        predicted: The one-step run where it is at hand.

    Returns:
        `value` holds the tests by output, `value["y"]`; `print` shows their tables,
        `value.summary` a sentence for each.
    """
    _check(network, lags, level, estimated)
    network.require_measured("The analysis of residuals")
    network.require_no_roots("The analysis of residuals")
    matched, batch = stack_batch(network, data)
    run = predict(network, data).value if predicted is None else predicted
    run = run.value if isinstance(run, Solution) else run
    found, left_out = [], []
    for place, name in enumerate(network.output_names):
        samples = sum(int(np.sum(scored[:, place])) for scored in run.scored)
        if samples < lags + SPARE_SAMPLES:
            left_out.append(name)
            continue
        one = one_step(network, batch, run, place, estimated=estimated)
        if one.residual.squares <= 0 or one.residual.freedom < lags + SPARE_SAMPLES:
            left_out.append(name)
            continue
        err = error_reduction(selection, name)
        found.append(_output(network, matched, batch, one, lags, level, over, err))
    value = Diagnostics(tuple(found), lags, level, check_gains(network, matched))
    stats = {"samples": np.array([one.samples for one in found])}
    if not left_out:
        return Solution(value, RESULTS.ok, stats)
    detail = (
        f"residuals of {', '.join(left_out)} were not tested: a test of {lags} lags "
        f"needs {lags + SPARE_SAMPLES} samples beside those for the parameters, and "
        "residuals that are not zero"
    )
    return Solution(value, RESULTS.too_short, stats, detail)


def _check(network: Any, lags: int, level: float, estimated: Any) -> None:
    if not isinstance(network, Network):
        raise SpecError(
            f"residual tests need the regressors of a Network, got "
            f"{type(network).__name__}",
            field="network",
        )
    if isinstance(lags, bool) or int(lags) != lags or lags < 1:
        raise SpecError(f"lags must be a whole number >= 1, got {lags}", field="lags")
    if not 0 < level <= 0.5:
        raise SpecError(
            f"level is the probability of a false alarm, above 0 and up to 0.5, got "
            f"{level}; 0.05 gives bounds of 95 %",
            field="level",
        )
    if estimated not in (None, "global", "local", "no"):
        raise SpecError(
            f"estimated is 'global', 'local', 'no' or None, got {estimated!r}",
            field="estimated",
        )


def _output(
    network: Network,
    data: Dataset,
    batch: Batch,
    one: OneStep,
    lags: int,
    level: float,
    over: Sequence[str],
    err: dict[str, float],
) -> OutputDiagnostics:
    residual = one.residual
    tests = tuple(_correlations(network, batch, one, lags, level))
    single = (
        ljung_box(residual, tests[0]),
        runs_test(residual),
        normality(residual),
        mean_test(residual),
    )
    whole = residual.value + (residual.mean if residual.centred else 0.0)
    whole = np.where(residual.known, whole * one.unit, np.nan)
    return OutputDiagnostics(
        output=one.output,
        samples=residual.samples,
        parameters=residual.parameters,
        mean=residual.mean * one.unit,
        deviation=residual.deviation * one.unit,
        estimated=one.estimated,
        errors=tuple(row[: len(r)] for row, r in zip(whole, data, strict=True)),
        lag_tests=tests,
        scalar_tests=tuple(test for test in single if test is not None),
        operating_points=_operating_points(network, batch, one, over),
        coefficients=coefficients(network, one, err),
        condition=one.design.condition,
        influences=influences(one, data),
    )


def _correlations(
    network: Network, batch: Batch, one: OneStep, lags: int, level: float
) -> Iterator[LagTest]:
    """Correlations of the residual alone, then of every input."""
    residual, scores = one.residual, normal_scores_of_squares(one.residual)
    yield autocorrelation(residual, lags=lags, level=level)
    yield changing_variance(residual, lags=lags, level=level)
    yield output_product(residual, one.measured, lags=lags, level=level)
    for signal, channel in enumerate(network.channels.inputs):
        values, known = usable_inputs(batch, signal)
        if not known.any() or np.ptp(values[known]) == 0:
            continue
        named: dict[str, Any] = {"signal": channel.name, "lags": lags, "level": level}
        yield input_correlation(residual, values, known, **named)
        named["scores"] = scores
        yield from higher_order(residual, values, known, one.measured, **named)


def _operating_points(
    network: Network, batch: Batch, one: OneStep, over: Sequence[str]
) -> tuple[OperatingPoint, ...]:
    variables = _variables(network, one.place, over)
    every = np.flatnonzero(one.residual.known)
    table = row_columns(batch, every, variables, float(network.sample_time))
    units = [network.channels.all[s].unit for s, _ in variables]
    names = variable_names(network.channels, variables)
    found = [
        bin_by_operating_point(one.residual, x.astype(float), variable=name, unit=unit)
        for x, name, unit in zip(table, names, units, strict=True)
    ]
    return tuple(p.times(one.unit) for p in found if p is not None)


def _variables(network: Network, place: int, over: Sequence[str]) -> Variables:
    if over:
        chosen = [parse_variable(network.channels, name) for name in over]
        deepest = max(lag for _, lag, _ in Variables.of(chosen).entries)
        if deepest > network.history:
            raise DataError(
                f"over looks {deepest} samples back, the model itself {network.history}"
            )
        return Variables.of(chosen)
    if len(network.models[place].scheduling):
        return network.models[place].scheduling
    least: dict[int, int] = {}
    for signal, lag, filter_ in network.variables.entries:
        if filter_ is None and signal not in network.signals:
            least[signal] = min(lag, least.get(signal, lag))
    return Variables.of([(signal, lag, None) for signal, lag in least.items()])
