"""Figures of networks, selections, searches and linear models, as `jnx.plot`.

Every function is one call and returns a matplotlib `Figure`: a notebook shows it by
itself, `figure.axes` are its axes in reading order to write on, and `figure.savefig` or
`jnx.plot.save` writes it. What has several outputs is asked for one by `output`, by
default the first. matplotlib is loaded on first use of `jnx.plot`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from jaxtyping import Array
from matplotlib.figure import Figure

import jaxnarx.evaluation as evaluation
from jaxnarx.calibration import Calibration
from jaxnarx.checks import choice, require_known
from jaxnarx.confidence import Uncertainty
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError, suggest
from jaxnarx.evaluation import describe_partition, diagnose, report
from jaxnarx.identification import Leaderboard, describe
from jaxnarx.inverse import Tracking
from jaxnarx.models import Network
from jaxnarx.selection import Selection, criteria_of
from jaxnarx.shell.figures import comparison, steady_states
from jaxnarx.shell.figures import partition as regions
from jaxnarx.shell.figures import relevance as worth
from jaxnarx.shell.figures import report as figures
from jaxnarx.shell.figures import residuals as tests
from jaxnarx.shell.figures.adaptation import adaptation_picture
from jaxnarx.shell.figures.calibration import map_picture, trajectories
from jaxnarx.shell.figures.draw import draw
from jaxnarx.shell.figures.leaderboard import COST_LABELS, error_over_operations
from jaxnarx.shell.figures.linear import bode, poles, step_responses
from jaxnarx.shell.figures.local_models import local_models
from jaxnarx.shell.figures.style import save
from jaxnarx.shell.figures.tracking import draw_tracking
from jaxnarx.shell.figures.tree import tree
from jaxnarx.solution import Solution

__all__ = [
    "adaptation",
    "bode",
    "calibrated_cycle",
    "calibrated_map",
    "compare",
    "error_map",
    "errors_by_size",
    "free_run",
    "gates",
    "intersections",
    "leaderboard",
    "local_models",
    "partition",
    "poles",
    "relevance",
    "residuals",
    "response_surface",
    "save",
    "selection_path",
    "step_responses",
    "tracking",
]


def __dir__() -> list[str]:
    return sorted(__all__)


def adaptation(found: Solution[Network]) -> Figure:
    """Draw what `jnx.linear.adapt` has returned: by windows the error, that of the
    network as it began, and their difference."""
    return draw(adaptation_picture(found))


def calibrated_map(calibration: Calibration, name: str) -> Figure:
    """Draw a map of `jnx.calibration.optimise` before, after, and what has changed;
    points that the cycle never visits are crossed."""
    names = [one.name for one in calibration.maps]
    require_known(name, names, "name", f"there is no map {name!r}")
    return draw(map_picture(calibration.maps[names.index(name)]))


def calibrated_cycle(calibration: Calibration, *, record: int = 0) -> Figure:
    """Draw what maps set, outputs and the domain's index over a record of the cycle,
    before and after."""
    count = len(calibration.inputs)
    if record not in range(count):
        raise SpecError(
            f"record must be from 0 to {count - 1}, got {record}", field="record"
        )
    return draw(trajectories(calibration, record))


def partition(
    network: Network,
    data: Dataset | None = None,
    *,
    start: Network | None = None,
    output: str | None = None,
) -> Figure:
    """Draw the regions of an output's local models.

    `start`, the network before its refinement, stands beside it; `data` lie under it.
    """
    return draw(regions.partition(_entry(network, data, start, output)))


def gates(
    network: Network, *, start: Network | None = None, output: str | None = None
) -> Figure:
    """The gates of a sigmoid tree as a list: what every branch lies above or below.

    `start`, the network before its refinement, stands beside it.
    """
    entry = _entry(network, None, start, output)
    if "gates" not in entry["after"]:
        raise SpecError(
            "the regions are no tree and have no gates; jnx.plot.partition draws them",
            field="network",
        )
    return draw(tree(entry))


def _entry(network: Network, data, start, output: str | None) -> dict[str, Any]:
    entries = describe_partition(network, start=start, data=data)
    name = _require_output(output, list(network.output_names))
    if output is None and entries:
        return next(iter(entries.values()))
    if name not in entries:
        raise SpecError(
            f"{name} has one local model that is valid everywhere; there is no "
            "partition to draw",
            field="output",
        )
    return entries[name]


def free_run(
    network: Network,
    data: Dataset,
    *,
    record: int | None = None,
    output: str | None = None,
) -> Figure:
    """Measurement, free run and one-step prediction of a record, the residual below.

    Default: the record with the largest error in free run.
    """
    name = _require_output(output, list(network.output_names))
    chosen = data if record is None else data[record]
    found = report(
        network, chosen, horizons=(1,), stability=False, diagnostics=False
    ).traces
    trace = next((t for t in found if t.output.name == name), None)
    if trace is None:
        raise SpecError(f"no sample of {name} can be scored", field="data")
    error = "diverged" if trace.rmse is None else f"RMSE {trace.rmse:.4g}"
    picture = figures.draw_free_run(
        trace.time,
        trace.measured,
        trace.simulated,
        label=trace.output.label,
        title=f"{name}, record {trace.record}: {error}",
        one_step=trace.one_step,
        limited=trace.limited,
        scored=trace.scored,
    )
    return draw(picture)


def compare(
    models: Network | Mapping[str, Network],
    data: Dataset | Mapping[str, Dataset],
    *,
    output: str | None = None,
    record: str | None = None,
) -> Figure:
    """Free runs of several models beside the measurement, every part on one page.

    `models` by name, `data` by the name of their part, `{"train": ..., "test": ...}`;
    one alone is welcome. Of each part that record is drawn which the first model fits
    worst, or `record` by name.
    """
    found = evaluation.compare(models, data, output=output)
    if record is None:
        return comparison.draw_comparison(found, [found.worst(p) for p in found.parts])
    named = [one for one in found.records if one.record == record]
    if not named:
        names = list(dict.fromkeys(one.record for one in found.records))
        raise SpecError(
            f"no record {record!r}. {suggest(record, names)}", field="record"
        )
    return comparison.draw_comparison(found, named)


def tracking(
    ways: Solution[Any] | Mapping[str, Solution[Any]],
    references: Dataset,
    *,
    record: int = 0,
) -> Figure:
    """Draw what cascades and controllers make of a record of references, and their
    commands.

    `ways` are what `jnx.inverse.cascade` and `jnx.control.close_loop` returned for
    `references`, by name; one alone is welcome.
    """
    if record not in range(len(references)):
        raise SpecError(
            f"record must be from 0 to {len(references) - 1}, got {record}",
            field="record",
        )
    if isinstance(ways, Solution):
        alone = "inverse" if isinstance(ways.value, Tracking) else "controller"
        ways = {alone: ways}
    return draw_tracking(ways, float(references.sample_time), record=record)


def selection_path(selection: Selection, *, output: str | None = None) -> Figure:
    """Error reduction of the terms in order of choice, and the criteria by size."""
    names = selection.output_names
    o = names.index(_require_output(output, names))
    count, table = selection.size(o), criteria_of(selection, o)
    shown = (("AICc", "aicc"), ("BIC", "bic"), ("FPE", "fpe"))
    picture = figures.selection_path(
        selection.names_of(names[o]),
        selection.err[o, :count],
        criteria={label: table[key] for label, key in shown},
    )
    return draw(picture)


def errors_by_size(
    selection: Selection,
    data: Dataset | Mapping[str, Dataset],
    *,
    output: str | None = None,
) -> Figure:
    """Error in free run and one step over the number of terms, and over operations.

    `data` by the name of their part, or one alone; see
    `jnx.evaluation.errors_by_size`.
    """
    names = selection.output_names
    found = evaluation.errors_by_size(selection, data)
    return comparison.draw_errors_by_size(
        found[names.index(_require_output(output, names))]
    )


def leaderboard(
    board: Leaderboard, *, output: str | None = None, by: str = "operations"
) -> Figure:
    """The candidates of a search: error of the free run over operations of a sample.

    `by="parameters"` shows it over the number of parameters.
    """
    choice(by, tuple(COST_LABELS), "by")
    entry = describe(board, _require_output(output, board.outputs))
    return draw(error_over_operations(entry, by=by))


RESIDUAL_VIEWS = ("lags", "operating points", "free run")
"""What residuals are drawn over."""


def residuals(
    network: Network,
    data: Dataset,
    *,
    output: str | None = None,
    over: str = "lags",
) -> Figure:
    """Residuals of one-step prediction: correlations by lag, with their bounds.

    `over="operating points"` shows their mean over every variable instead, and
    `"free run"` correlations of the free run's residual with the inputs.
    """
    name = _require_output(output, list(network.output_names))
    choice(over, RESIDUAL_VIEWS, "over")
    if over == "free run":
        solution = evaluation.diagnose_free_run(network, data)
        free = [one for one in solution.value if one.output.name == name]
        if not free:
            raise SpecError(
                f"the free run of {name} was not tested: {solution.status_name}",
                field="data",
            )
        return draw(tests.free_run(free[0]))
    found = diagnose(network, data).value.outputs
    one = next(d for d in found if d.output.name == name)
    if over == "lags":
        return draw(tests.correlations(one))
    picture = tests.operating_points(one)
    if picture is None:
        raise SpecError("no variable moves over these data", field="over")
    return draw(picture)


def error_map(
    network: Network,
    data: Dataset,
    *,
    over: Sequence[str] | None = None,
    output: str | None = None,
) -> Figure:
    """Free-run error, bias, spread and number of samples over two variables.

    By default the variables that schedule; see `jnx.evaluation.error_map`.
    """
    found = evaluation.error_map(network, data, over=over, output=output)
    return draw(figures.error_map(found))


def relevance(
    network: Network,
    data: Dataset,
    *,
    how: str = "mean",
    key: Array | None = None,
    block: float | int | None = None,
) -> Figure:
    """Free-run error without each input, all outputs; see `jnx.evaluation.relevance`.

    An input is held at its mean, or with `how="permuted"` and a `key` its blocks
    change places.
    """
    found = evaluation.relevance(network, data, how=how, key=key, block=block)
    return worth.relevance(found)


def intersections(
    network: Network,
    data: Dataset,
    *,
    at: Mapping[str, float] | None = None,
    over: Sequence[str] | None = None,
    uncertainty: Uncertainty | None = None,
) -> Figure:
    """Outputs at rest over one input at a time, the others at an operating point.

    With bands where the network knows its errors or `uncertainty` is given; see
    `jnx.evaluation.intersections`.
    """
    found = evaluation.intersections(
        network, data, at=at, over=over, uncertainty=uncertainty
    )
    return steady_states.intersections(found)


def response_surface(
    network: Network,
    data: Dataset,
    over: Sequence[str],
    *,
    output: str | None = None,
    at: Mapping[str, float] | None = None,
    cells: int = 21,
) -> Figure:
    """One output at rest over two inputs; see `jnx.evaluation.response_surface`."""
    found = evaluation.response_surface(
        network, data, over, output=output, at=at, cells=cells
    )
    return steady_states.response_surface(found)


def _require_output(output: str | None, names: list[str]) -> str:
    if output is None:
        return names[0]
    if output not in names:
        raise SpecError(
            f"no output {output!r}. {suggest(output, names)}", field="output"
        )
    return output
