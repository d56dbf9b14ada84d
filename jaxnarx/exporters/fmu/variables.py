"""The variables of an FMU: what an importer sees of a program, in order.

A value's reference is its place here: inputs, those that a model learns from, reported
outputs, flags, what has been learnt, totals, whether bounds acted, past outputs, the
choice of a start, values given from before it, time, and constant maps.
"""

import dataclasses
from collections.abc import Iterable

from jaxnarx.data import sum_over_time
from jaxnarx.exporters.form import HALF_FLAG_PREFIX, Port, SampleProgram, Value

LIMITED_TEXT = "the bound of what is fed back has acted on"
FLAG_TEXTS = {
    "extrapolated": "1: an input is beyond its trained range, or missing",
    "index": "distance from the training, one at its border",
    "missing": "samples in a row at which an input is NaN or infinite; it is held",
    "invalid": "1: an input has been missing for too long, or since the start",
}
"""Descriptions of the flags."""
LEARNT_TEXTS = {
    "rmse": "error of the last window of samples",
    "rmse_start": "the same of the model as it began",
    "drift": "difference of the two models over that window",
    "undone": "windows whose learning made the error grow, and was undone",
}
"""Descriptions of what is told of every output of a model that learns."""
LEARN_TEXT = "1: learn from the measured outputs, as they are set"


@dataclasses.dataclass(frozen=True)
class Quantity:
    """One variable; `kind` is `real`, `boolean`, `choice`, `time` or `array`.

    `sees` are the inputs that an output depends on at its own time, `shape` and
    `values` those of a constant array. What is `relative` is a difference or a sum, of
    which a unit's offset is no part.
    """

    name: str
    kind: str
    causality: str
    about: str
    unit: str = ""
    start: float | None = None
    sees: tuple[int, ...] = ()
    values: tuple[float, ...] = ()
    shape: tuple[int, ...] = ()
    relative: bool = False


def quantities(
    program: SampleProgram, version: int, *, learns: bool = False
) -> tuple[Quantity, ...]:
    """All of them, of a model that `learns` also what it learns from; FMI 3.0 wants
    time among them."""
    taken: set[str] = set()

    def name(text: str) -> str:
        return free_name(text, taken)

    def output(
        label: str,
        n: Value,
        kind: str,
        about: str,
        unit: str = "",
        *,
        relative: bool = False,
    ) -> Quantity:
        ops = (program.ops[k] for k in program.needed_operations([n]))
        sees = sorted({op.source for op in ops if op.kind == "input"}, key=int)
        return Quantity(
            label, kind, "output", about, unit, sees=tuple(sees), relative=relative
        )

    inputs = [
        Quantity(name(p.name), "real", "input", _describe_range(p), p.unit, _middle(p))
        for p in program.inputs
    ]
    followed = program.reported if learns else ()
    measured = [
        Quantity(
            name(f"measured.{p.name}"),
            "real",
            "input",
            f"{p.name} as it is measured now; NaN where it is not",
            p.unit,
            _middle(p),
        )
        for p in followed
    ]
    if learns:
        measured.append(Quantity(name("learn"), "real", "input", LEARN_TEXT, "", 0.0))
    reported = [
        output(name(p.name), n, "real", _describe_range(p), p.unit)
        for p, n in zip(program.reported, program.outputs, strict=True)
    ]
    units = program.flag_units
    flags = [
        output(
            name(flag),
            n,
            "real",
            _flag(flag),
            units.get(flag, ""),
            relative=flag in units,
        )
        for flag, n in program.flags.items()
    ]
    totals = [
        output(
            name(f"total.{program.reported[o].name}"),
            program.outputs[o],
            "real",
            f"{program.reported[o].name}, summed over the run up to this sample",
            unit,
            relative=True,
        )
        for o, unit, _ in summed_outputs(program)
    ]
    learnt = [
        Quantity(
            name(f"{kind}.{p.name}"),
            "real",
            "output",
            f"{p.name}: {text}",
            "" if kind == "undone" else p.unit,
            relative=True,
        )
        for p in followed
        for kind, text in LEARNT_TEXTS.items()
    ]
    limited = [
        output(name(f"limited.{p.name}"), n, "boolean", f"{LIMITED_TEXT} {p.name}")
        for p, n in zip(program.computed, program.limited, strict=True)
    ]
    past = [
        Quantity(
            name(f"past.{program.computed[o].name}[{k}]"),
            "real",
            "local",
            f"what is fed back, {k} before this sample",
            program.computed[o].unit,
        )
        for o, k in past_entries(program)
    ]
    choice = Quantity(
        name("start"), "choice", "parameter", "what a run starts from", start=0.0
    )
    lags = [
        Quantity(
            name(f"given.{p.name}[{k + 1}]"),
            "real",
            "parameter",
            f"measured {k + 1} before the first sample, for start = given",
            p.unit,
            _middle(p),
        )
        for p in (*program.inputs, *program.computed)
        for k in range(program.history)
    ]
    time = Quantity(name("time"), "time", "independent", "time", "s")
    own = (*inputs, *measured, *reported, *flags, *learnt, *totals)
    found = (*own, *limited, *past, choice, *lags)
    return (*found, time) if version == 3 else found


def summed_outputs(program: SampleProgram) -> list[tuple[int, str, float]]:
    """Reported outputs that are rates: place, unit of their sum over time, and how many
    seconds the time of that unit has."""
    found = [(o, sum_over_time(p.unit)) for o, p in enumerate(program.reported)]
    return [(o, *one) for o, one in found if one is not None]


def past_entries(program: SampleProgram) -> list[tuple[int, int]]:
    """The output and the lag of every entry of `program.past`."""
    order = list(dict.fromkeys(line for line, _ in program.past))
    own = [program.ops[n] for n in program.fed]
    lines = {d.name: d.source for d in program.delays}
    by_line = {
        line: next(
            o
            for o, (n, op) in enumerate(zip(program.fed, own, strict=True))
            if lines[line] in (n, *op.args)
        )
        for line in order
    }
    return [(by_line[line], k) for line, k in program.past]


def past_gains(program: SampleProgram) -> list[float]:
    """Physical value over value in its line, of every entry of `program.past`."""
    lines = {d.name: d.source for d in program.delays}
    found = []
    for (line, _), (o, _) in zip(program.past, past_entries(program), strict=True):
        n = program.fed[o]
        factors = [program.ops[a] for a in program.ops[n].args if a != lines[line]]
        found.append(1.0 if n == lines[line] else float(factors[0].source))
    return found


def _flag(flag: str) -> str:
    if flag.startswith(HALF_FLAG_PREFIX):
        return f"half of the prediction interval of {flag[len(HALF_FLAG_PREFIX) :]}"
    return FLAG_TEXTS.get(flag, f"{flag} at this sample")


def _describe_range(port: Port) -> str:
    return f"trained from {port.low:.6g} to {port.high:.6g}"


def _middle(port: Port) -> float:
    return 0.5 * (port.low + port.high)


def free_name(text: str, taken: set[str]) -> str:
    """Different from what is taken; channels have no names that XML cannot carry."""
    found, n = text, 2
    while found in taken:
        found, n = f"{text}_{n}", n + 1
    taken.add(found)
    return found


def units(variables: Iterable[Quantity]) -> list[str]:
    """Every unit once."""
    return list(dict.fromkeys(v.unit for v in variables if v.unit))
