"""The whole path for the command line: identify, report, save."""

import dataclasses
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.data import Channels, Dataset, Preparation
from jaxnarx.errors import DataError, SpecError, suggest
from jaxnarx.evaluation import Report, Verdict, describe_partition, report
from jaxnarx.identification import drop_unneeded, make_pool
from jaxnarx.identification import identify as verb
from jaxnarx.models import Network, save
from jaxnarx.selection import Selection
from jaxnarx.settings import (
    ForwardOLS,
    Identification,
    SimulationError,
    SimulationOLS,
    replace_at,
)
from jaxnarx.shell.description import tell_findings
from jaxnarx.shell.messages import count, first_lines, say
from jaxnarx.shell.next_command import tell_next
from jaxnarx.shell.output import write_report, write_together
from jaxnarx.shell.progress import (
    refinement_progress,
    selection_progress,
)
from jaxnarx.solution import Solution


@dataclasses.dataclass(frozen=True)
class OneMethod:
    """Everything a run of the path is told."""

    method: Identification
    command: str
    preparation: dict[str, Any] | None = None
    """What was done to the records before, kept with the model."""
    prepared: str | None = None
    """The same in words, for the report."""


def check_method(method: Identification, channels: Channels) -> Identification:
    """The method for data with these channels, its outputs by name; `SpecError` where a
    name is wrong, before any work is done.
    """
    pool, known = method.pool, channels.output_names
    for name in pool.outputs:
        if name not in known:
            raise SpecError(
                f"outputs: there is no output {name!r}. {suggest(name, known)}",
                field="outputs",
            )
    outputs = pool.outputs or tuple(known)
    if isinstance(method.select, SimulationOLS) and len(outputs) > 1:
        raise SpecError(
            "--select simulation takes one output at a time; add "
            f"--output {outputs[0]!r}, say"
        )
    for name in _logarithmic_outputs(method):
        if name not in outputs:
            raise SpecError(
                f"--log: {name!r} is not modelled. {suggest(name, outputs)}"
            )
    return replace_at(method, {"pool.outputs": outputs})


def preparation_task(preparation: Preparation | None, task: OneMethod) -> OneMethod:
    """The task for records that were prepared so, which the model will tell."""
    if preparation is None:
        return task
    told = preparation.describe()
    say(f"The records are prepared:\n{told}")
    return dataclasses.replace(task, preparation=preparation.to_dict(), prepared=told)


def identify(
    task: OneMethod,
    parts: dict[str, Dataset],
    folder: Path,
    *,
    follow: Callable[[Verdict], str],
) -> Report:
    """Identify on `parts["train"]`, guard on "validate", report on all of them.

    Writes `model.safetensors`, `report.json` and `report.html` into `folder`, all or
    none. `follow` returns the command to type next. Returns the report.
    """
    begin = time.perf_counter()
    method = task.method
    parts = {name: drop_unneeded(data, method) for name, data in parts.items()}
    history = make_pool(method.pool, parts["train"].channels).variables.longest
    require_rows(parts, history)
    tell_findings(parts["train"])
    with Teller(method) as tell:
        train, judges = parts["train"], parts["validate"]
        fit = verb(train, method, validation=judges, progress=tell)
    grown = fit.stats["grown"].value
    result = _report(task, parts, fit)
    result = dataclasses.replace(result, next_command=follow(result.verdict))
    with write_together(folder) as place:
        about: dict[str, Any] = {"command": task.command}
        if task.preparation is not None:
            about["preparation"] = task.preparation
        save(fit.value, place / "model.safetensors", about=about)
        write_report(result, place)
    say("\n" + first_lines(result))
    say("\n" + _summary(result, grown, parts))
    say(
        f"\n{time.perf_counter() - begin:.1f} s; wrote model.safetensors, report.json "
        f"and report.html to {folder}"
    )
    say(f"\nOpen {folder / 'report.html'}")
    tell_next(result.next_command)
    return result


class Teller(ExitStack):
    """The reporter of an identification while it runs."""

    def __init__(self, method: Identification):
        super().__init__()
        self.method, self.progress = method, selection_progress

    def __call__(self, row: dict[str, Any]) -> None:
        ended, verb = row.get("solution"), row["verb"]
        if "candidates" in row:
            self._begin(row["candidates"])
        elif ended is None:
            self.progress(row)
        elif verb == "refine":
            self.close()  # the bar, or its last line
            say(f"  {_describe_refinement(ended, self.method)}")
        else:
            _tell(ended)
            if verb == "grow":
                self._tell_regions(ended.value)

    def _begin(self, candidates: int) -> None:
        asked = getattr(self.method.select, "max_terms", candidates)
        most = "" if isinstance(self.method.select, ForwardOLS) else "up to "
        say(f"Choosing {most}{min(asked, candidates)} of {candidates} terms")
        if asked > candidates:
            say(f"  {asked} were asked for; there are no more candidates")

    def _tell_regions(self, network: Network) -> None:
        for name, model in zip(network.computed_names, network.models, strict=True):
            terms = count(model.local.index.shape[1], "term")
            of = "of" if np.asarray(model.local.used).all() else "of up to"
            own = 0 if model.own is None else int(np.asarray(model.own).sum())
            fed = f", {own} with feedback of their own" if own else ""
            models = count(int(np.asarray(model.active).sum()), "local model")
            say(f"{name}: {models} {of} {terms}{fed}")
        if isinstance(self.method.refine, SimulationError):
            say("Refining on the free run")
        elif self.method.refine is not None:
            say("Refining on the one-step error")
        if self.method.refine is not None:
            self.progress = self.enter_context(refinement_progress())


def _logarithmic_outputs(method: Identification) -> tuple[str, ...]:
    """Outputs whose errors are refined on a logarithmic scale."""
    powers = getattr(method.refine, "box_cox", None)
    return tuple(powers) if isinstance(powers, Mapping) else ()


REFINEMENT_ENDS = {
    "ok": "converged",
    "budget_spent": "all steps used",
    "no_improvement": "stopped where validation improves no further",
}
"""Usual ends of a refinement in words."""


def _describe_refinement(fit: Solution[Network], method: Identification) -> str:
    """Why the refinement ended, and what it did to the records that judge."""
    refine = method.refine
    squared = getattr(refine, "loss", "squares") == "squares"
    start, end = fit.stats["loss_start"], fit.stats["loss"]
    name = "loss"
    if squared and not _logarithmic_outputs(method):
        name, start, end = "NRMSE", start**0.5, end**0.5
    mode = "free-run" if isinstance(refine, SimulationError) else "one-step"
    _, mark, more = fit.detail.partition(";")
    ended = REFINEMENT_ENDS.get(fit.status_name, fit.status_name)
    return f"{ended}: {mode} {name} on validation {start:.4g} -> {end:.4g}{mark}{more}"


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


def _report(
    task: OneMethod, parts: dict[str, Dataset], fit: Solution[Network]
) -> Report:
    refined, grown = fit.stats["refined"], fit.stats["grown"]
    told = {"command": task.command}
    if refined is not None:
        told["refinement"] = _describe_refinement(refined, task.method)
    if task.prepared is not None:
        told["preparation"] = task.prepared
    steps = [
        {k: row[k] for k in ("stage", "horizon", "loss", "validation", "damping")}
        | {"iteration": row["step"]}
        for row in (refined.stats["history"] if refined is not None else [])
    ]
    start, data = grown.value, parts["train"]
    return report(
        fit.value,
        parts,
        selection=_selection(fit.stats["selection"]),
        history=steps,
        partition=describe_partition(fit.value, start=start, data=data),
        beside={} if refined is None else {"before refinement": start},
        provenance=told,
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
            one = source.pooled_row(channel.name, part=result.main, mode="one step")
            free = source.pooled_row(channel.name, part=result.main)
            fit = "-" if free.fit is None else f"{free.fit:.1f}"
            lines.append(
                f"{channel.name:{wide}s} {label:14s} {_number(one):>12s} "
                f"{_number(free):>12s} {fit:>8s}"
            )
    return "\n".join(lines)


def _number(row) -> str:
    return row.status if row.rmse is None else f"{row.rmse:.5g}"
