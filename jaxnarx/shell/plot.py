"""Figures of networks, selections and linear models, as `jnx.plot`.

Every function returns a matplotlib `Figure`, which a notebook shows and
`figure.savefig` writes. What has several outputs is asked for one by `output`, by
default the first. matplotlib is loaded on first use of `jnx.plot`.
"""

from typing import Any

from matplotlib.figure import Figure

from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError, suggest
from jaxnarx.evaluation import describe_partition, diagnose, report
from jaxnarx.identification import Leaderboard, described
from jaxnarx.models import Network
from jaxnarx.selection import Selection, criteria_of
from jaxnarx.shell import figures, partition_figure, residual_figure
from jaxnarx.shell.leaderboard_figure import error_over_operations
from jaxnarx.shell.linear_figures import bode, poles, step_responses
from jaxnarx.shell.local_models_figure import local_models
from jaxnarx.shell.style import save

__all__ = [
    "bode",
    "free_run",
    "leaderboard",
    "local_models",
    "partition",
    "poles",
    "residuals",
    "save",
    "selection_path",
    "step_responses",
]


def partition(
    network: Network,
    data: Dataset | None = None,
    *,
    start: Network | None = None,
    output: str | None = None,
) -> Figure:
    """Where the local models of an output are valid.

    `start`, the network before its refinement, stands beside it; `data` lie under it.
    """
    return partition_figure.partition(_entry(network, data, start, output))


def _entry(network: Network, data, start, output: str | None) -> dict[str, Any]:
    entries = describe_partition(network, start=start, data=data)
    name = _named(output, list(network.output_names))
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
    name = _named(output, list(network.output_names))
    chosen = data if record is None else data[record]
    found = report(
        network, chosen, horizons=(1,), stability=False, diagnostics=False
    ).traces
    trace = next((t for t in found if t.output.name == name), None)
    if trace is None:
        raise SpecError(f"no sample of {name} can be scored", field="data")
    error = "diverged" if trace.rmse is None else f"RMSE {trace.rmse:.4g}"
    return figures.measured_and_simulated(
        trace.time,
        trace.measured,
        trace.simulated,
        label=trace.output.label,
        title=f"{name}, record {trace.record}: {error}",
        one_step=trace.one_step,
        limited=trace.limited,
        scored=trace.scored,
    )


def selection_path(selection: Selection, *, output: str | None = None) -> Figure:
    """Error reduction of the terms in order of choice, and the criteria by size."""
    names = selection.output_names
    o = names.index(_named(output, names))
    count, table = selection.size(o), criteria_of(selection, o)
    shown = (("AICc", "aicc"), ("BIC", "bic"), ("FPE", "fpe"))
    return figures.selection_path(
        selection.names_of(names[o]),
        selection.err[o, :count],
        criteria={label: table[key] for label, key in shown},
    )


def leaderboard(board: Leaderboard, *, output: str | None = None) -> Figure:
    """The candidates of a search: error of the free run over operations of a sample."""
    return error_over_operations(described(board, _named(output, board.outputs)))


def residuals(
    network: Network,
    data: Dataset,
    *,
    output: str | None = None,
    over: str = "lags",
) -> Figure:
    """Residuals of one-step prediction: correlations by lag, with their bounds.

    `over="operating points"` shows their mean over every variable instead.
    """
    name = _named(output, list(network.output_names))
    found = diagnose(network, data).value.outputs
    one = next(d for d in found if d.output.name == name)
    if over == "lags":
        return residual_figure.correlations(one)
    figure = residual_figure.operating_points(one)
    if over != "operating points" or figure is None:
        raise SpecError(
            f'over is "lags" or, where variables move, "operating points"; got '
            f"{over!r}",
            field="over",
        )
    return figure


def _named(output: str | None, names: list[str]) -> str:
    if output is None:
        return names[0]
    if output not in names:
        raise SpecError(
            f"no output {output!r}. {suggest(output, names)}", field="output"
        )
    return output
