"""The whole path for the command line: choose terms, grow, refine, report, save."""

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.evaluation import Report, report
from jaxnarx.evaluation.regions import describe_partition
from jaxnarx.methods import ForwardOLS, Global, Lolimot, SimulationError
from jaxnarx.models import Network, save
from jaxnarx.partition import grow
from jaxnarx.refinement import refine
from jaxnarx.regressors import polynomial_pool
from jaxnarx.selection import Selection, select
from jaxnarx.shell.output import write_report
from jaxnarx.shell.progress import refinement_progress, say
from jaxnarx.solution import Solution


@dataclasses.dataclass(frozen=True)
class Plan:
    """Everything a run of the path is told."""

    outputs: tuple[str, ...]
    input_lags: tuple[int, ...]
    output_lags: tuple[int, ...]
    degree: int
    select: ForwardOLS
    grow: Global | Lolimot
    refine: SimulationError
    command: str


def identify(plan: Plan, parts: dict[str, Dataset], folder: Path) -> Report:
    """Identify on `parts["train"]`, guard on "validate", report on all of them.

    Writes `model.safetensors`, `report.json` and `report.html` into `folder`.
    """
    begin = time.perf_counter()
    train, validate = parts["train"], parts["validate"]
    pool = polynomial_pool(
        train.channels,
        outputs=plan.outputs,
        input_lags=plan.input_lags,
        output_lags=plan.output_lags,
        degree=plan.degree,
    )
    say(f"Choosing {plan.select.max_terms} of {len(pool)} terms")
    chosen = select(pool, train, plan.select)
    _tell(chosen)
    grown = grow(chosen.value, train, plan.grow)
    _tell(grown)
    for name, model in zip(plan.outputs, grown.value.models, strict=True):
        count = int(model.active.sum())
        say(f"{name}: {count} local model{'s' if count > 1 else ''} of "
            f"{model.local.index.shape[1]} terms")
    say("Refining on the free run")
    with refinement_progress() as progress:
        fit = refine(
            grown.value, train, plan.refine, validation=validate, progress=progress
        )
    say(f"  {fit.status_name}: {fit.detail}")
    result = _report(plan, parts, chosen, grown.value, fit)
    save(fit.value, folder / "model.safetensors", about={"command": plan.command})
    write_report(result, folder)
    say("\n" + _summary(result, grown.value, parts))
    say(f"\n{time.perf_counter() - begin:.1f} s; wrote model.safetensors, report.json "
        f"and report.html to {folder}")
    return result


def _tell(solution: Solution) -> None:
    passed_over = solution.stats.get("passed_over", {})
    for channel, reason in passed_over.items():
        say(f"  terms of {channel} are passed over: {reason}")
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
        partition=describe_partition(fit.value, start=start),
        provenance={"command": plan.command, "refinement": fit.detail},
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
    lines.append(f"{'':20s} {'one step':>12s} {'free run':>12s} {'fit %':>8s}")
    for channel in result.outputs:
        for label, source in (("one-step model", before), ("refined", result)):
            one = source.pooled(channel.name, part=result.main, mode="one step")
            free = source.pooled(channel.name, part=result.main)
            fit = "-" if free.fit is None else f"{free.fit:.1f}"
            lines.append(
                f"{channel.name[:5]:5s} {label:14s} {_number(one):>12s} "
                f"{_number(free):>12s} {fit:>8s}"
            )
    return "\n".join(lines)


def _number(row) -> str:
    return row.status if row.rmse is None else f"{row.rmse:.5g}"

