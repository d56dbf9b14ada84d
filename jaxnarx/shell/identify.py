"""The whole path for the command line: choose terms, grow, refine, report, save."""

import dataclasses
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.data import Channels, Dataset, Preparation, match_channels
from jaxnarx.errors import DataError, SpecError, suggest
from jaxnarx.evaluation import Report, report
from jaxnarx.evaluation.regions import describe_partition
from jaxnarx.methods import (
    Backward,
    ForwardOLS,
    Global,
    Lolimot,
    SigmoidTree,
    SimulationError,
    SimulationOLS,
    StepwiseF,
)
from jaxnarx.models import Network, save
from jaxnarx.partition import grow
from jaxnarx.refinement import refine
from jaxnarx.regressors import LowPass, parse_variable, polynomial_pool
from jaxnarx.selection import Selection, select
from jaxnarx.shell.commands import Identify
from jaxnarx.shell.messages import count, say
from jaxnarx.shell.output import write_report, written_together
from jaxnarx.shell.progress import (
    refinement_progress,
    selection_progress,
)
from jaxnarx.solution import Solution

Choice = ForwardOLS | StepwiseF | Backward | SimulationOLS
Growth = Global | Lolimot | SigmoidTree


@dataclasses.dataclass(frozen=True)
class Plan:
    """Everything a run of the path is told."""

    outputs: tuple[str, ...]
    input_lags: tuple[int, ...]
    output_lags: tuple[int, ...]
    degree: int
    select: Choice
    grow: Growth
    refine: SimulationError
    command: str
    filters: tuple[LowPass, ...] = ()
    """First-order lags through which every input enters as well."""
    preparation: dict[str, Any] | None = None
    """What was done to the records before, kept with the model."""
    prepared: str | None = None
    """The same in words, for the report."""

    @property
    def logarithmic(self) -> tuple[str, ...]:
        """Outputs whose errors are refined on a logarithmic scale."""
        powers = self.refine.box_cox
        return tuple(powers) if isinstance(powers, Mapping) else ()

    def on(self, channels: Channels) -> "Plan":
        """The plan for data with these channels: no output named means all of them."""
        known = channels.output_names
        for name in self.outputs:
            if name not in known:
                raise SpecError(
                    f"--output: there is no output {name!r}. {suggest(name, known)}"
                )
        outputs = tuple(dict.fromkeys(self.outputs)) or tuple(known)
        if isinstance(self.select, SimulationOLS) and len(outputs) > 1:
            raise SpecError(
                "--select simulation takes one output at a time; add "
                f"--output {outputs[0]!r}, say"
            )
        wrong = [name for name in self.logarithmic if name not in outputs]
        if wrong:
            raise SpecError(
                f"--log: {wrong[0]!r} is not modelled. {suggest(wrong[0], outputs)}"
            )
        return dataclasses.replace(self, outputs=outputs)


def make_plan(command: Identify, typed: str) -> Plan:
    """What the flags say, checked as far as that can be done without data."""
    if command.models < 1:
        raise SpecError(f"--models must be at least 1, got {command.models}")
    if command.models > 1 and not command.schedule:
        raise SpecError(
            "--models above 1 needs --schedule, the variables that divide the "
            "operating space, such as --schedule 'speed[t]'"
        )
    if command.schedule and command.models == 1:
        raise SpecError("--schedule needs --models above 1")
    if not 0 <= command.ridge < math.inf:
        raise SpecError(f"--ridge must not be negative, got {command.ridge}")
    if not 0 < command.hold_out < 1:
        raise SpecError(f"--hold-out must lie between 0 and 1, got {command.hold_out}")
    return Plan(
        outputs=command.output,
        input_lags=command.input_lags,
        output_lags=command.output_lags,
        filters=_lags_of_first_order(command.filters),
        degree=command.degree,
        select=_choice(command),
        grow=_growth(command),
        refine=SimulationError(
            horizons=command.horizons,
            max_steps=command.steps,
            window_steps=command.window_steps if command.steps else 0,
            train=command.train,
            ridge=command.ridge,
            loss=command.loss,
            box_cox=dict.fromkeys(command.log, 0.0) if command.log else 1.0,
            starts=command.starts,
        ),
        command=typed,
    )


def _growth(command: Identify) -> Growth:
    """The settings of the growth that --models and --partition name."""
    if command.local_terms < 0:
        raise SpecError(
            f"--local-terms must not be negative, got {command.local_terms}"
        )
    if command.models == 1:
        if command.local_terms:
            raise SpecError("--local-terms needs --models above 1")
        if command.feedback != "network":
            raise SpecError("--feedback needs --models above 1")
        return Global()
    local = None
    if command.local_terms:
        local = ForwardOLS(max_terms=command.local_terms)
    common: dict[str, Any] = {
        "scheduling": command.schedule,
        "max_models": command.models,
        "criterion": command.criterion,
        "local": local,
        "feedback": command.feedback,
    }
    if command.partition == "lolimot":
        return Lolimot(k_sigma=command.k_sigma, **common)
    return SigmoidTree(oblique=command.partition == "tree", **common)


def _choice(command: Identify) -> Choice:
    """The settings of the selection that --select names."""
    if command.constant != "first" and command.select != "err":
        raise SpecError(f"--constant {command.constant} belongs to --select err")
    by_f = {"max_terms": command.terms, "significance": command.significance}
    if command.select == "stepwise":
        return StepwiseF(**by_f)
    if command.select == "backward":
        return Backward(**by_f)
    if command.select == "simulation":
        few = min(command.terms, SimulationOLS.start_terms)
        return SimulationOLS(max_terms=command.terms, start_terms=few)
    return ForwardOLS(max_terms=command.terms, constant=command.constant)


def _lags_of_first_order(time_constants: tuple[float, ...]) -> tuple[LowPass, ...]:
    """The filters of these time constants [s]."""
    if not all(0 < t < math.inf for t in time_constants):
        given = " ".join(f"{t:g}" for t in time_constants)
        raise SpecError(
            f"--filters must be positive time constants in seconds, got {given}"
        )
    return tuple(LowPass(t) for t in dict.fromkeys(time_constants))


def prepared_by(preparation: Preparation | None, plan: Plan) -> Plan:
    """The plan for records that were prepared so, which the model will tell."""
    if preparation is None:
        return plan
    told = preparation.describe()
    say(f"The records are prepared:\n{told}")
    return dataclasses.replace(plan, preparation=preparation.to_dict(), prepared=told)


def identify(plan: Plan, parts: dict[str, Dataset], folder: Path) -> Report:
    """Identify on `parts["train"]`, guard on "validate", report on all of them.

    Writes `model.safetensors`, `report.json` and `report.html` into `folder`, all or
    none. Returns the report.
    """
    begin = time.perf_counter()
    parts = {name: _needed(data, plan) for name, data in parts.items()}
    train, validate = parts["train"], parts["validate"]
    pool = polynomial_pool(
        train.channels,
        outputs=plan.outputs,
        input_lags=plan.input_lags,
        output_lags=plan.output_lags,
        filters=plan.filters,
        degree=plan.degree,
    )
    require_rows(parts, pool.variables.longest)
    most = "" if isinstance(plan.select, ForwardOLS) else "up to "
    size = min(plan.select.max_terms, len(pool))
    say(f"Choosing {most}{size} of {len(pool)} terms")
    if plan.select.max_terms > size:
        say(f"  {plan.select.max_terms} were asked for; there are no more candidates")
    chosen = select(pool, train, plan.select, progress=selection_progress)
    _tell(chosen)
    grown = _grown(chosen, train, validate, plan)
    _tell(grown)
    for name, model in zip(plan.outputs, grown.value.models, strict=True):
        terms = count(model.local.index.shape[1], "term")
        of = "of" if np.asarray(model.local.used).all() else "of up to"
        own = 0 if model.own is None else int(model.own.sum())
        fed = f", {own} with feedback of their own" if own else ""
        models = count(int(np.asarray(model.active).sum()), "local model")
        say(f"{name}: {models} {of} {terms}{fed}")
    say("Refining on the free run")
    with refinement_progress() as progress:
        fit = refine(
            grown.value, train, plan.refine, validation=validate, progress=progress
        )
    say(f"  {_refined(fit, plan)}")
    result = _report(plan, parts, chosen, grown.value, fit)
    with written_together(folder) as place:
        about: dict[str, Any] = {"command": plan.command}
        if plan.preparation is not None:
            about["preparation"] = plan.preparation
        save(fit.value, place / "model.safetensors", about=about)
        write_report(result, place)
    say("\n" + _summary(result, grown.value, parts))
    say(
        f"\n{time.perf_counter() - begin:.1f} s; wrote model.safetensors, report.json "
        f"and report.html to {folder}"
    )
    say(f"\n{result.verdict.sentence}")
    return result


STOPPED = {
    "ok": "converged",
    "budget_spent": "all steps used",
    "no_improvement": "stopped where validation improves no further",
}
"""Usual ends of a refinement in words."""


def _refined(fit: Solution[Network], plan: Plan) -> str:
    """Why the refinement ended, and what it did to the records that judge."""
    squared = plan.refine.loss == "squares" and not plan.logarithmic
    start, end = fit.stats["loss_start"], fit.stats["loss"]
    name = "loss"
    if squared:
        name, start, end = "NRMSE", start**0.5, end**0.5
    _, mark, more = fit.detail.partition(";")
    ended = STOPPED.get(fit.status_name, fit.status_name)
    return (
        f"{ended}: free-run {name} on validation {start:.4g} -> {end:.4g}{mark}{more}"
    )


def _grown(
    chosen: Solution[Selection], train: Dataset, validate: Dataset, plan: Plan
) -> Solution[Network]:
    """The network to refine: of one model, what a choice in free run ended with."""
    network = chosen.stats.get("network")
    if network is not None and isinstance(plan.grow, Global):
        return Solution(network, chosen.status, {})
    return grow(chosen.value, train, plan.grow, validation=validate)


def _needed(data: Dataset, plan: Plan) -> Dataset:
    """Without outputs that the model neither computes nor is scheduled on.

    New data would otherwise have to bring them along.
    """
    known = data.channels
    scheduling = () if isinstance(plan.grow, Global) else plan.grow.scheduling
    used = {known.names[parse_variable(known, text)[0]] for text in scheduling}
    kept = tuple(c for c in known.outputs if c.name in used.union(plan.outputs))
    return match_channels(data, Channels(known.inputs, kept))[0]


def require_rows(parts: dict[str, Dataset], history: int) -> None:
    """DataError unless each part has a record that reaches past the lags.

    The report predicts ten steps ahead from a complete history.
    """
    for name, data in parts.items():
        record = max(data, key=len)
        if len(record) <= history + 10:
            raise DataError(
                f"{name}: the longest record, {record.name}, has "
                f"{count(len(record), 'row')}; lags up to {history} and ten steps need "
                f"more than {history + 10}. Use smaller lags or longer records."
            )


def _tell(solution: Solution) -> None:
    reasons: dict[str, list[str]] = {}
    for name, reason in solution.stats.get("passed_over", {}).items():
        reasons.setdefault(reason, []).append(name)
    for reason, names in reasons.items():
        more = f" and {len(names) - 8} more" if len(names) > 8 else ""
        listed = ", ".join(names[:8]) + more
        say(f"  terms of {listed} are passed over: {reason}")
    if solution.detail:
        say(f"  {solution.status_name}: {solution.detail}")


def _report(plan, parts, chosen, start: Network, fit: Solution[Network]) -> Report:
    steps = [
        {k: row[k] for k in ("stage", "horizon", "loss", "validation", "damping")}
        | {"iteration": row["step"]}
        for row in fit.stats["history"]
    ]
    return report(
        fit.value,
        parts,
        selection=_selection(chosen),
        history=steps,
        partition=describe_partition(fit.value, start=start, data=parts["train"]),
        provenance={"command": plan.command, "refinement": _refined(fit, plan)}
        | ({} if plan.prepared is None else {"preparation": plan.prepared}),
    )


def _selection(chosen: Solution[Selection]) -> dict[str, dict[str, Any]]:
    value, out = chosen.value, {}
    for o, position in enumerate(value.pool.outputs):
        count = len(value.terms(o))
        name = value.pool.channels.output_names[position]
        err = value.err[o, :count]
        out[name] = {
            "names": [value.pool.name(t) for t in value.terms(o)],
            "err": err.tolist(),
            "cumulative": np.cumsum(err).tolist(),
            "criteria": {
                label: chosen.stats[key][o, :count].tolist()
                for label, key in (("AICc", "aicc"), ("BIC", "bic"), ("FPE", "fpe"))
            },
        }
    return out


def _summary(result: Report, start: Network, parts: dict[str, Dataset]) -> str:
    """Pooled figures of the main part: one step, and free run before and after."""
    before = report(start, {result.main: parts[result.main]}, horizons=(1,))
    lines = [f"On {result.main}: RMSE pooled over the records"]
    wide = max(len(channel.name) for channel in result.outputs)
    head = f"{'one step':>12s} {'free run':>12s} {'fit %':>8s}"
    lines.append(f"{'':{wide}s} {'':14s} {head}")
    for channel in result.outputs:
        for label, source in (("one-step model", before), ("refined", result)):
            one = source.pooled(channel.name, part=result.main, mode="one step")
            free = source.pooled(channel.name, part=result.main)
            fit = "-" if free.fit is None else f"{free.fit:.1f}"
            lines.append(
                f"{channel.name:{wide}s} {label:14s} {_number(one):>12s} "
                f"{_number(free):>12s} {fit:>8s}"
            )
    return "\n".join(lines)


def _number(row) -> str:
    return row.status if row.rmse is None else f"{row.rmse:.5g}"
