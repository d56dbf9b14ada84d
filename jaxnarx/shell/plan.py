"""The next test of a model, as files."""

import functools
from collections.abc import Callable

import numpy as np

from jaxnarx import fleet
from jaxnarx.design import TestPlan, plan
from jaxnarx.errors import SpecError
from jaxnarx.models import load
from jaxnarx.shell import output
from jaxnarx.shell.commands import Plan
from jaxnarx.shell.formats import table_csv
from jaxnarx.shell.messages import count, quote_command, say, warn
from jaxnarx.shell.next_command import tell_next
from jaxnarx.shell.parse_ranges import parse_assignment, parse_seconds
from jaxnarx.shell.record_files import describe, record_csv
from jaxnarx.solution import Solution

PLAN_FILE, DESCRIPTION_FILE, PREDICTED_FILE = "plan.csv", "plan.toml", "predicted.csv"
PRIOR_SUFFIX = ".fleet"
"""End of the name of a file that is a fleet's prior, not a model."""
ARGUMENT_OPTIONS = {
    "ranges": "range",
    "rates": "rate",
    "forbidden": "forbid",
    "limits": "limit",
    "hold": "hold",
}
"""Arguments of the verb, and the options that they are."""


def plan_test(command: Plan, typed: str) -> int:
    """Plan, write, tell; returns the exit code."""
    asked = _verb_arguments(command)
    make = _maker(command.model)
    marks = [PLAN_FILE, DESCRIPTION_FILE, PREDICTED_FILE]
    with output.run_folder(command.out, "", force=command.force, marks=marks) as folder:
        try:
            found = make(**asked)
        except SpecError as error:
            if error.field not in ARGUMENT_OPTIONS:
                raise
            text = str(error).removeprefix(f"{error.field} ")
            raise SpecError(f"--{ARGUMENT_OPTIONS[error.field]} {text}") from error
        data = found.value.data
        texts = {
            PLAN_FILE: record_csv(data, 0),
            DESCRIPTION_FILE: describe(data, {"files": [PLAN_FILE]}, by=typed),
            PREDICTED_FILE: predicted_csv(found.value),
        }
        with output.write_together(folder) as place:
            for name, text in texts.items():
                output.write_text(place / name, text)
    say(f"{count(len(data.records[0]), 'sample')} of {data.sample_time:g} s")
    say(found.detail)
    for name, room in found.stats["room"].items():
        say(f"{name}: predicted {room:.4g} or more inside of its limit")
    if not found.is_okay:
        warn(f"{found.status_name}: limits leave little to be planned; widen them")
    say(f"wrote {PLAN_FILE}, {DESCRIPTION_FILE} and {PREDICTED_FILE} to {folder}")
    if command.model.lower().endswith(PRIOR_SUFFIX):
        words = ("jaxnarx", "fleet", "calibrate", command.model, "MEASURED.csv")
    else:
        plan_file = str(folder / DESCRIPTION_FILE)
        words = ("jaxnarx", "check", plan_file, "--model", command.model)
    tell_next(quote_command(*words))
    return 0


def _maker(path: str) -> Callable[..., Solution[TestPlan]]:
    """What makes plans: of a model, or of a fleet."""
    if path.lower().endswith(PRIOR_SUFFIX):
        return functools.partial(fleet.plan, fleet.load_prior(path))
    return functools.partial(plan, load(path))


def _verb_arguments(command: Plan) -> dict:
    """The arguments of the verb."""
    ranges = [parse_assignment(t, "--range", "NAME=LOW:HIGH", 2) for t in command.range]
    rates = [parse_assignment(t, "--rate", "NAME=RATE", 1) for t in command.rate]
    form = "NAME=HIGHEST or NAME=LOWEST:HIGHEST"
    limits = [parse_assignment(t, "--limit", form, 1, 2) for t in command.limit]
    return {
        "duration": parse_seconds(command.duration, "--duration"),
        "ranges": {name: tuple(pair) for name, *pair in ranges},
        "rates": dict(rates),
        "forbidden": command.forbid,
        "limits": {n: x[0] if len(x) == 1 else tuple(x) for n, *x in limits},
        "hold": tuple(parse_seconds(t, "--hold") for t in command.hold or ()) or None,
        "seed": command.seed,
    }


def predicted_csv(value: TestPlan) -> str:
    """Predicted outputs with what a limit is kept clear of by, and the index."""
    time = np.arange(len(value.index)) * value.data.sample_time
    header, columns = ["time [s]"], [time]
    for o, name in enumerate(value.output_names):
        header += [f"{name} predicted", f"{name} margin"]
        columns += [value.outputs[:, o], value.margin[:, o]]
    header.append("index")
    return table_csv(header, [c.tolist() for c in (*columns, value.index)])
