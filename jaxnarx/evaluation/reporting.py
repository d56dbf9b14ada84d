"""The verb `report`: figures of a network by part, output, record and mode of use."""

import importlib.metadata
import platform
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import positive, require
from jaxnarx.confidence import DomainIndex, Intervals
from jaxnarx.data import Channel, Dataset, convert_units, data_hash
from jaxnarx.errors import SpecError
from jaxnarx.evaluation._cost import cost
from jaxnarx.evaluation._error_map import error_maps
from jaxnarx.evaluation._reactivation import reactivation_notes
from jaxnarx.evaluation._region_errors import region_errors
from jaxnarx.evaluation._report import Report
from jaxnarx.evaluation.analyses import run_analyses
from jaxnarx.evaluation.baseline import BASELINE_NAME, linear_runs
from jaxnarx.evaluation.coverage import coverage, coverage_notes, interval_runs
from jaxnarx.evaluation.domain_errors import (
    domain_errors,
    domain_indices,
    domain_notes,
)
from jaxnarx.evaluation.effect_sizes import effects
from jaxnarx.evaluation.error_distribution import error_distribution
from jaxnarx.evaluation.extrapolation import find_outside, held_notes, range_notes
from jaxnarx.evaluation.gain_signs import (
    GainFinding,
    check_gains,
)
from jaxnarx.evaluation.page_records import ShownRecord, shown_records
from jaxnarx.evaluation.physics_checks import section_of_physics
from jaxnarx.evaluation.regions import describe_partition
from jaxnarx.evaluation.remarks import (
    assess,
    data_notes,
    score_notes,
    stability_notes,
)
from jaxnarx.evaluation.residual_tests import Diagnostics, diagnose
from jaxnarx.evaluation.rows import (
    FREE_RUN,
    Row,
    ScoredSamples,
    collect,
    mode_name,
    score,
)
from jaxnarx.evaluation.section import FreeRun, Section
from jaxnarx.evaluation.table import name_data
from jaxnarx.evaluation.traces import Residuals, Trace, choose, residuals
from jaxnarx.evaluation.worst_segments import worst_stretches
from jaxnarx.formatting import count
from jaxnarx.models import FLAG, Network
from jaxnarx.settings import Physics
from jaxnarx.simulation import Prepared, predict, prepare, simulate

OtherRuns = list[tuple[Channel, list[ScoredSamples]]]
"""Samples of another model, record by record, for each of its outputs."""


@runtime_checkable
class Reportable(Protocol):
    """A model that can be reported: a `Network`, or what can be run and shown as
    one."""

    @property
    def channels(self) -> Any: ...
    @property
    def models(self) -> Any: ...
    @property
    def output_channels(self) -> Any: ...
    @property
    def equations(self) -> Any: ...


@guard_arguments
def report(
    network: Reportable,
    data: Dataset | Mapping[str, Dataset],
    *,
    horizons: Sequence[int] = (1, 10),
    simulated: Any = None,
    selection: Mapping[str, Any] | None = None,
    history: Sequence[Mapping[str, Any]] | None = None,
    partition: Mapping[str, Any] | None = None,
    stability: Any = True,
    diagnostics: Diagnostics | bool = True,
    beside: Mapping[str, Reportable] | None = None,
    leaderboard: Mapping[str, Any] | None = None,
    over: Sequence[str] | None = None,
    within: float | int | None = None,
    physics: Mapping[str, Physics] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Report:
    """Score `network` on `data`: k-step prediction for each horizon, and free run.

    Every figure is in physical units over the samples that are valid and have enough
    history. Divergence is reported as a status, never as a number. A record that is in
    two parts is noted loudly.

    Args:
        network: The model.
        data: One dataset, or several by the name of their part: `"train"`,
            `"validate"`, `"test"`.
        horizons: Numbers of steps ahead to predict.
        simulated: The free run where it is at hand: what `simulate` returned, or a dict
            of that by part.
        selection: Stored in the form that `Report` tells, as is `history`.
        history: The steps of the refinement.
        partition: It is shown instead of the network's own; that of
            `describe_partition(network, start=before)` also shows the network before
            refinement.
        stability: True assesses up to 2000 samples of the main part, False leaves it
            out; a `Stability` at hand is shown as it is.
        diagnostics: Likewise the tests of the one-step residuals of the main part, and
            with them of the signs of its steady-state gains.
        beside: Other networks by name, whose free run on the main part is scored as
            well.
        leaderboard: Stored in the form that `Report` tells; the verdict knows it.
        over: Two channels, or lagged variables, over which the error is mapped; default
            the two that schedule most of each output.
        within: Tolerance of the free-run error in the unit of the outputs; the report
            tells the share of the samples that keep it.
        physics: What is known by output: the report counts gains at rest with another
            sign over the main part, and tells time constants that are too long.
        provenance: Text that is stored beside the versions and data hashes.

    Returns:
        A `Report`: `print` shows its table, `verdict` what the model is good for.

    Example:
        report = jnx.report(network, data, stability=False, diagnostics=False)
        print(report)
        print(report.verdict)
    """
    parts = dict(data) if isinstance(data, Mapping) else {"data": data}
    _check(parts, horizons)
    tolerance = None if within is None else positive(within, "within")
    main = "test" if "test" in parts else list(parts)[-1]
    if not (stability is None or isinstance(stability, bool)):
        _require_result(stability, "summary", "stability")
    parts = {
        part: convert_units(data, network.channels) for part, data in parts.items()
    }
    ready = {part: _ready(network, data) for part, data in parts.items()}
    outputs = tuple(network.output_channels)
    known = simulated if isinstance(simulated, Mapping) else {}
    if simulated is not None and not isinstance(simulated, Mapping):
        known = dict.fromkeys(list(parts)[:1], simulated)
    free = {part: _free_run(network, ready[part], known.get(part)) for part in parts}
    runs = {
        part: _runs(network, part_data, ready[part], outputs, horizons, free[part])
        for part, part_data in parts.items()
    }
    rows = tuple(row for part in parts for row in _rows(part, outputs, runs[part]))
    bounded = interval_runs(network, ready, free)
    traces, errors = _pictures(
        outputs, runs[main], parts[main].sample_time, bounded.get(main)
    )
    modelled = [channel.name for channel in outputs]
    notes = data_notes(parts, network.channels, modelled) + score_notes(rows)
    strayed = find_outside(network, parts)
    limits = _limits(network)
    beyond = network.outside if isinstance(network, Network) else FLAG
    notes += range_notes(rows, strayed, outside=beyond) + held_notes(rows)
    index = domain_indices(network, ready)
    known = domain_errors(index, main, outputs, runs[main][FREE_RUN])
    notes += domain_notes(known, main)
    held = [
        line
        for part, found in bounded.items()
        for line in coverage(part, outputs, found, runs[part][FREE_RUN])
    ]
    notes += coverage_notes(held, main)
    notes += reactivation_notes(network, parts[main])
    if stability is True:
        stability = assess(network, ready[main], free[main])
    notes += stability_notes(stability or None, main)
    tested, sentences = _diagnostics(network, ready[main], diagnostics, selection)
    notes += [f"One-step residuals on {main}: {text}" for text in sentences]
    if partition is None:
        partition = describe_partition(network, data=parts[main])
    others = _free_runs_beside(network, parts, main, runs[main][FREE_RUN], beside or {})
    scored_beside = {name: _pooled_rows(main, run) for name, run in others.items()}
    return Report(
        outputs=outputs,
        main=main,
        rows=rows,
        notes=tuple(notes),
        traces=traces,
        residuals=errors,
        equations=_equations(network),
        selection=selection,
        history=history,
        partition=partition or None,
        cost=cost(network).to_dict() if isinstance(network, Network) else None,
        stability=stability or None,
        diagnostics=tested,
        provenance=_provenance(parts) | dict(provenance or {}),
        outside=strayed,
        limits=limits,
        maps=error_maps(network, ready[main], runs[main][FREE_RUN], over),
        regions=region_errors(network, ready[main], runs[main][FREE_RUN]),
        leaderboard=leaderboard,
        domain=known,
        worst=worst_stretches(
            network, parts[main], outputs, runs[main][FREE_RUN], index.get(main)
        ),
        coverage=tuple(held),
        beside=scored_beside,
        distributions=tuple(
            one
            for o, channel in enumerate(outputs)
            if (one := error_distribution(channel, runs[main][FREE_RUN][o], tolerance))
        ),
        gains=_gains(network, parts[main], diagnostics, tested),
        effects=effects(main, rows, runs[main][FREE_RUN], others, known),
        sections=run_analyses(
            FreeRun(
                network,
                main,
                parts[main],
                outputs,
                runs[main][FREE_RUN],
                parts.get("train"),
            )
        )
        | _signs(network, parts[main], physics),
        network=network,
        records=_records_to_show(
            network, ready, main, outputs, runs, free, bounded, index, others
        ),
    )


def _records_to_show(
    network: Any,
    parts: Mapping[str, Dataset | Prepared],
    main: str,
    outputs: tuple[Channel, ...],
    runs: Mapping[str, Mapping[str, list[list[ScoredSamples]]]],
    free: Mapping[str, Any],
    bounded: Mapping[str, Intervals],
    index: Mapping[str, DomainIndex],
    others: Mapping[str, OtherRuns],
) -> tuple[ShownRecord, ...]:
    """Records of the main part, then of the others; runs of other models are known of
    the main one."""
    beside = {
        name: {channel.name: samples for channel, samples in run}
        for name, run in others.items()
    }
    return tuple(
        record
        for part in sorted(parts, key=lambda name: name != main)
        for record in shown_records(
            network,
            part,
            parts[part],
            outputs,
            getattr(free[part], "value", free[part]),
            runs[part][FREE_RUN],
            bounded.get(part),
            index.get(part),
            beside if part == main else {},
        )
    )


def _limits(network: Any) -> float | None:
    """The margin of the network's limits, None where it has none."""
    hold = network.hold if isinstance(network, Network) else None
    return None if hold is None else float(hold)


def _check(parts: Mapping[str, Dataset], horizons: Sequence[int]) -> None:
    empty = [name for name, data in parts.items() if len(data) == 0]
    if not parts or empty:
        raise SpecError(
            f"nothing to report on: {empty[0] if empty else 'data'!r} has no records",
            field="data",
        )
    if any(k != int(k) or k < 1 for k in horizons):
        raise SpecError(
            f"horizons are whole numbers of steps >= 1, got {tuple(horizons)}",
            field="horizons",
        )


def _diagnostics(
    network: Any,
    data: Dataset | Prepared,
    chosen: Diagnostics | bool,
    selection: Mapping[str, Any] | None,
) -> tuple[Diagnostics | None, list[str]]:
    """The residual analysis a report shows, and what it says in sentences.

    None where it is not wanted, and for what is no `Network`.
    """
    if isinstance(chosen, Diagnostics):
        return chosen, list(chosen.summary)
    if not chosen or not isinstance(network, Network):
        return None, []
    if network.hidden:
        return None, [
            "Residuals of one step were not tested: hidden states are estimated from "
            "the very measurements they would be compared with."
        ]
    if network.roots:
        return None, [
            f"Residuals of one step were not tested: of {', '.join(network.roots)} a "
            "root is computed, which the tests do not know."
        ]
    found = diagnose(network, data, selection=selection)
    more = [] if found.status_name == "ok" else [found.detail + "."]
    return found.value, [*found.value.summary, *more]


def _signs(
    network: Any, data: Dataset, physics: Mapping[str, Physics] | None
) -> dict[str, Section]:
    """The section of what physics asks, where it does."""
    if not physics or not isinstance(network, Network):
        return {}
    section = section_of_physics(network, data, physics)
    return {} if section is None else {"physics": section}


def _gains(
    network: Any, data: Dataset, chosen: Diagnostics | bool, tested: Diagnostics | None
) -> tuple[GainFinding, ...]:
    """Gains of the diagnostics; with hidden states, which have none, they are checked
    here."""
    if tested is not None:
        return tested.gains
    wanted = chosen is True and isinstance(network, Network)
    return check_gains(network, data) if wanted else ()


def _ready(network: Any, data: Dataset) -> Dataset | Prepared:
    """The records prepared once for all that follows; as they are for what is no
    `Network`."""
    return prepare(network, data) if isinstance(network, Network) else data


def _free_run(network: Any, data: Dataset | Prepared, simulated: Any) -> Any:
    if simulated is None:
        return simulate(network, data)
    _require_result(getattr(simulated, "value", simulated), "outputs", "simulated")
    return simulated


def _require_result(value: Any, attribute: str, field: str) -> None:
    """SpecError unless it is a result of a verb, by what such a one has."""
    require(
        hasattr(value, attribute),
        field,
        f"{field} is of type {type(value).__name__}, but must be what the verb returns",
    )


def _runs(
    network: Any,
    data: Dataset,
    ready: Dataset | Prepared,
    outputs: tuple[Channel, ...],
    horizons: Sequence[int],
    free: Any,
) -> dict[str, list[list[ScoredSamples]]]:
    """Samples by output and record, for every mode; the free run comes last."""
    runs = {
        mode_name(int(k)): predict(network, ready, k=int(k))
        for k in dict.fromkeys(horizons)
    }
    runs[FREE_RUN] = free
    return {
        mode: collect(data, outputs, getattr(run, "value", run))
        for mode, run in runs.items()
    }


def _free_runs_beside(
    network: Any,
    parts: Mapping[str, Dataset],
    main: str,
    free: list[list[ScoredSamples]],
    others: Mapping[str, Any],
) -> dict[str, OtherRuns]:
    """Free runs of the linear model and of `others` on the main part."""
    runs: dict[str, OtherRuns] = {}
    # Without lags of outputs a linear model of the same lags is no match for states.
    if isinstance(network, Network) and not network.hidden and "train" in parts:
        linear = linear_runs(network, parts["train"], parts[main], free)
        runs[BASELINE_NAME] = list(zip(network.output_channels, linear, strict=True))
    for name, other in others.items():
        channels = tuple(other.output_channels)
        run = _free_run(other, parts[main], None)
        found = collect(parts[main], channels, run.value)
        runs[name] = list(zip(channels, found, strict=True))
    return runs


def _pooled_rows(main: str, run: OtherRuns) -> tuple[Row, ...]:
    """Its rows of all records together."""
    return tuple(score(main, FREE_RUN, channel, found)[0] for channel, found in run)


def _rows(
    part: str, outputs: tuple[Channel, ...], runs: dict[str, list[list[ScoredSamples]]]
) -> list[Row]:
    """Rows by output, then record, then mode, so that modes stand beside one
    another."""
    rows = []
    for o, channel in enumerate(outputs):
        by_mode = [score(part, mode, channel, run[o]) for mode, run in runs.items()]
        rows += [row for record in zip(*by_mode, strict=True) for row in record]
    return rows


def _pictures(
    outputs: tuple[Channel, ...],
    runs: dict[str, list[list[ScoredSamples]]],
    sample_time: float,
    found: Intervals | None,
) -> tuple[tuple[Trace, ...], tuple[Residuals, ...]]:
    free, one = runs[FREE_RUN], runs.get(mode_name(1))

    def edges(o: int):
        if found is None:
            return None
        pairs = zip(found.lower, found.upper, strict=True)
        return [(lower[:, o], upper[:, o]) for lower, upper in pairs]

    traces = [
        choose(channel, free[o], one[o] if one else None, sample_time, edges(o))
        for o, channel in enumerate(outputs)
    ]
    errors = [residuals(channel, free[o]) for o, channel in enumerate(outputs)]
    return tuple(t for group in traces for t in group), tuple(errors)


def _equations(network: Any) -> tuple[dict[str, Any], ...]:
    """The text form of each local model with its LaTeX beside it."""
    plain, latex = network.equations(style="text"), network.equations(style="latex")
    return tuple(
        {**one, "latex": two["latex"]} for one, two in zip(plain, latex, strict=True)
    )


def _provenance(parts: Mapping[str, Dataset]) -> dict[str, Any]:
    versions = {"python": platform.python_version()}
    for package in ("jaxnarx", "jax", "numpy"):
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:  # run from a source folder
            versions[package] = "not installed"
    described = {
        name_data(part): f"{count(len(data), 'record')}, "
        f"{count(data.samples, 'sample')} at {data.sample_time:g} s; content "
        f"sha256 {data_hash(data)}"
        for part, data in parts.items()
    }
    return {"versions": versions} | described
