"""An inverse for the command line: identify, train through the model, judge, save."""

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.data import Dataset, match_channels
from jaxnarx.errors import SpecError, suggest
from jaxnarx.evaluation import report
from jaxnarx.identification import identify
from jaxnarx.inverse import (
    Tracking,
    cascade,
    compensate,
    inverse_data,
    invertible,
    unity_gain,
)
from jaxnarx.models import Network, save
from jaxnarx.settings import (
    ActuatorLimits,
    TrackingError,
    replace_at,
)
from jaxnarx.shell.commands import Invert
from jaxnarx.shell.identify import Teller
from jaxnarx.shell.messages import count, say
from jaxnarx.shell.output import write_report, write_text, write_together
from jaxnarx.shell.parse_ranges import parse_assignment
from jaxnarx.simulation import simulate
from jaxnarx.solution import Solution

MODEL_FILE, TRACKING_FILE, FIGURE_FILE = (
    "inverse.safetensors",
    "tracking.json",
    "tracking.png",
)
RESULT_FILES = (MODEL_FILE, "report.json", "report.html", TRACKING_FILE, FIGURE_FILE)


def limits_of(ranges: Sequence[str], rates: Sequence[str]) -> ActuatorLimits:
    """`THR=4:90` and `THR=200` as limits."""
    found: dict[str, tuple[float, float]] = {}
    for text in ranges:
        name, low, high = parse_assignment(text, "--range", "NAME=LOW:HIGH", 2)
        found[name] = low, high
    speed = {
        n: x for n, x in (parse_assignment(t, "--rate", "NAME=RATE", 1) for t in rates)
    }
    return ActuatorLimits(range=found, rate=speed)


def check_command(command: Invert, forward: Network) -> tuple[str, ...]:
    """The targets; `SpecError` where the flags do not fit each other or the model."""
    if not 0 < command.hold_out < 1:
        raise SpecError(f"--hold-out must lie between 0 and 1, got {command.hold_out}")
    targets = command.target or tuple(forward.output_names)
    known = forward.channels.input_names, forward.output_names
    for option, names, own in zip(
        ("--command", "--target"), (command.command, targets), known, strict=True
    ):
        for name in names:
            if name not in own:
                raise SpecError(
                    f"{option}: the model has no {name!r}. {suggest(name, own)}"
                )
    return tuple(dict.fromkeys(targets))


def invert(
    command: Invert, typed: str, forward: Network, parts: dict[str, Dataset], out: Path
) -> Solution[Tracking]:
    """Identify on `parts["train"]`, guard on "validate", follow references of the last.

    Writes `RESULT_FILES` into `out`, all or none; returns the cascade on the last part.
    """
    targets = check_command(command, forward)
    limits = limits_of(command.range, command.rate)
    parts = {n: match_channels(d, forward.channels)[0] for n, d in parts.items()}
    found = invertible(
        forward,
        parts["train"],
        commands=command.command,
        targets=targets,
        lead=command.lead,
        limits=limits,
    )
    say(f"{found.value.findings}")
    backwards = {
        name: inverse_data(
            data,
            commands=command.command,
            targets=targets,
            lead=command.lead,
            forward=forward,
            states=command.state,
        )
        for name, data in parts.items()
    }
    direct = _fit_direct(command, backwards)
    trained = _train(command, direct, forward, parts, limits)
    last = list(parts)[-1]
    ways = {"direct": direct, "trained": trained}
    followed = {
        name: cascade(network, forward, parts[last], limits)
        for name, network in ways.items()
    }
    gain = unity_gain(trained, forward, parts["train"], limits=limits)
    _tell(followed, last, gain.value.worst())
    text = {
        "command": typed,
        "findings": found.value.findings.to_dict(),
        "lead": found.value.lead,
        "part": last,
        "tracking": {name: _figures(s) for name, s in followed.items()},
        "static_gain_off_one": _finite_or_none(gain.value.worst()),
    }
    with write_together(out) as place:
        save(trained, place / MODEL_FILE, about={"command": typed})
        write_report(report(trained, backwards, provenance={"command": typed}), place)
        write_text(place / TRACKING_FILE, json.dumps(text, allow_nan=False, indent=1))
        from jaxnarx.shell.figures.style import save as save_figure
        from jaxnarx.shell.figures.tracking import draw_tracking

        save_figure(
            draw_tracking(followed, float(forward.sample_time)), place / FIGURE_FILE
        )
    return followed["trained"]


def _fit_direct(command: Invert, data: dict[str, Dataset]) -> Network:
    """The inverse by itself: terms, regions, and its own free run."""
    train, lags = data["train"], command.method.pool.input_lags
    references = {name: lags for name in train.channels.input_names}
    for name in command.state:
        references[name] = tuple(k for k in lags if k) or (1,)
    method = replace_at(command.method, {"pool.input_lags": references})
    say("The inverse by itself")
    with Teller(method) as tell:
        fit = identify(train, method, validation=data["validate"], progress=tell)
    return fit.value


def _train(
    command: Invert,
    direct: Network,
    forward: Network,
    parts: dict[str, Dataset],
    limits: ActuatorLimits,
) -> Network:
    if not command.steps:
        return direct
    say("Training the inverse through the model, on what the model itself can do")
    own = {
        name: _reached_records(forward, parts[name]) for name in ("train", "validate")
    }
    method = TrackingError(effort=command.effort, max_steps=command.steps)
    fit = compensate(
        direct,
        forward,
        own["train"],
        method,
        validation=own["validate"],
        limits=limits,
    )
    say(f"  {fit.status_name}: {fit.detail}, {count(fit.stats['steps'], 'step')}")
    return fit.value


def _reached_records(forward: Network, data: Dataset) -> Dataset:
    """The records with the outputs that the model computes under their commands.

    With the measured ones the inverse would learn to make good the model's error, which
    the engine does not have. A record on which the model diverges stays as it is, and
    no limits hold what is reached: it is what the model's own feedback goes on.
    """
    found = simulate(forward, data).value
    at = [data.channels.output_names.index(n) for n in found.output_names]
    records = []
    for n, record in enumerate(data):
        y = np.array(record.y)
        if not found.diverged[n].any():
            y[:, at] = found.computed[n]
        records.append(dataclasses.replace(record, y=y))
    return dataclasses.replace(data, records=tuple(records))


def _tell(followed: dict[str, Solution[Tracking]], part: str, worst: float) -> None:
    """Tracking errors of both inverses, and how near the cascade comes to one."""
    say(f"\nThe model under the inverse's commands, references of {part}: NRMSE")
    names = followed["trained"].value.target_names
    say(f"{'':10s}" + "".join(f"{name[:12]:>13s}" for name in names))
    for way, solution in followed.items():
        cells = "".join(f"{_format_error(x):>13s}" for x in _errors(solution))
        say(
            f"{way:10s}{cells}" + (f"  {solution.status_name}" * (not solution.is_okay))
        )
    if math.isfinite(worst):
        say(f"Static gain from reference to output: within {worst:.1%} of one")
    else:
        say("Static gain from reference to output: no point comes to rest off a limit")
    share = np.mean(np.concatenate(followed["trained"].value.at_range), axis=0)
    for name, held in zip(followed["trained"].value.command_names, share, strict=True):
        if held >= 0.01:
            say(f"{name} rests at a limit of its range {held:.0%} of the time")


def _errors(solution: Solution[Tracking]) -> list[float | None]:
    """Tracking error of every target; None where the cascade diverges."""
    if not solution.is_okay:
        return [None] * len(solution.value.targets)
    return [_finite_or_none(float(x)) for x in solution.value.nrmse()]


def _figures(solution: Solution[Tracking]) -> dict[str, Any]:
    value = solution.value
    return {
        "status": solution.status_name,
        "detail": solution.detail,
        "nrmse": dict(zip(value.target_names, _errors(solution), strict=True)),
    }


def _finite_or_none(x: float) -> float | None:
    return x if math.isfinite(x) else None


def _format_error(x: float | None) -> str:
    return "-" if x is None else f"{x:.4f}"
