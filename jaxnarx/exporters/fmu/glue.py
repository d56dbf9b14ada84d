"""The C between FMI and a program: definitions of one model, then the texts beside."""

from collections.abc import Sequence
from importlib import resources

from jaxnarx.exporters.code import digits
from jaxnarx.exporters.fmu.variables import (
    LEARNT_TEXTS,
    Quantity,
    past_gains,
    summed_outputs,
)
from jaxnarx.exporters.form import SampleProgram


def read_template(file: str, program: SampleProgram | None = None) -> str:
    """A text of this folder, with a program's name in it."""
    path = resources.files("jaxnarx.exporters.fmu") / file
    text = path.read_text(encoding="utf-8")
    if program is None:
        return text
    return text.replace("NAME_", f"{program.name}_").replace(
        "UPPER_", f"{program.name.upper()}_"
    )


def wrapper(
    program: SampleProgram,
    variables: Sequence[Quantity],
    token: str,
    version: int,
    *,
    learns: bool = False,
) -> str:
    """The source that has the functions of FMI."""
    files = ["unit.c", "fmi2.c"] if version == 2 else ["unit.c", "fmi3.c"]
    files += ["fmi3_rest.c"] if version == 3 else []
    head = [
        f"/* FMI {version}.0 for {program.name}.",
        " * SPDX-License-Identifier: Apache-2.0 */",
        f'#include "{program.name}{"_adapt" if learns else ""}.h"',
        f'#include "fmi{version}Functions.h"',
        "",
        "#include <float.h>",
        "#include <math.h>",
        "#include <stddef.h>",
        "#include <stdint.h>",
        "#include <stdlib.h>",
        "#include <string.h>",
        "",
        *_definitions(program, variables, token, version, learns),
        read_template("learns.c" if learns else "fixed.c", program),
    ]
    return "\n".join([*head, *(read_template(file, program) for file in files)])


def _definitions(
    program: SampleProgram,
    variables: Sequence[Quantity],
    token: str,
    version: int,
    learns: bool,
) -> list[str]:
    name, upper = program.name, program.name.upper()
    outputs, totals = len(program.reported), summed_outputs(program)
    counts = {
        "INPUT": len(program.inputs) + (outputs + 1 if learns else 0),
        "REPORTED": outputs,
        "FLAG": len(program.flags),
        "LEARNT": len(LEARNT_TEXTS) * outputs if learns else 0,
        "TOTAL": len(totals),
        "LIMITED": len(program.limited),
        "PAST": len(program.past),
        "START": 1 + program.history * (len(program.inputs) + len(program.computed)),
    }
    places, place = [], 0
    for what, count in counts.items():
        places.append(f"#define FMI_AT_{what} {place}u")
        place += count
    values = [v.start or 0.0 for v in variables]
    starts = values[: counts["INPUT"]]
    lags = values[place - counts["START"] + 1 : place]
    flags = [
        f"    v[{k}] = (double)out->{flag};" for k, flag in enumerate(program.flags)
    ]
    gains = past_gains(program)
    steps = [program.sample_time / seconds for *_, seconds in totals]
    places_summed = ", ".join(str(o) for o in (*(o for o, *_ in totals), 0))
    past = [
        f"    v[{k}] = {digits(gain)} * (double)s->{line}[{lag - 1}];"
        for k, ((line, lag), gain) in enumerate(zip(program.past, gains, strict=True))
    ]
    return [
        f'#define TOKEN "{token}"',
        "",
        "/* where values of a kind begin among the references */",
        *places[1:],
        f"#define FMI_AT_TIME {place}u",
        f"#define HAS_TIME {int(version == 3)}",
        f"#define FLAGS {len(program.flags)}",
        f"#define LEARNS {int(learns)}",
        f"#define LEARNT {counts['LEARNT']}",
        f"#define TOTALS {len(totals)}",
        f"#define PAST {upper}_PAST",
        f"#define LAGS {len(lags)}",
        f"#define ROWS {max(program.history, 1)}",
        "",
        *_arrays(variables),
        _numbers("fmi_input_starts[FMI_AT_REPORTED]", starts),
        _numbers("fmi_lag_starts[LAGS + 1]", [*lags, 0.0]),
        _numbers("fmi_past_gains[PAST + 1]", [*gains, 1.0]),
        _numbers("fmi_total_steps[TOTALS + 1]", [*steps, 0.0]),
        f"static const size_t fmi_total_outputs[TOTALS + 1] = {{{places_summed}}};",
        "",
        f"static void fmi_unit_flags(const {name}_out *out, double *v)",
        "{",
        *(flags or ["    (void)out;", "    (void)v;"]),
        "}",
        "",
        f"static void fmi_unit_past(const {name}_state *s, double *v)",
        "{",
        *(past or ["    (void)s;", "    (void)v;"]),
        "}",
        "",
    ]


def _arrays(variables: Sequence[Quantity]) -> list[str]:
    """Constant arrays behind the other variables: their numbers, and where each one's
    begin."""
    arrays = [v for v in variables if v.shape]
    if not arrays:
        return ["#define ARRAYS 0u"]
    starts = [0]
    for one in arrays:
        starts.append(starts[-1] + len(one.values))
    places = ", ".join(map(str, starts))
    return [
        f"#define ARRAYS {len(arrays)}u",
        f"static const size_t fmi_array_starts[ARRAYS + 1] = {{{places}}};",
        _numbers(f"fmi_arrays[{starts[-1]}]", [x for v in arrays for x in v.values]),
    ]


def _numbers(what: str, values: Sequence[float]) -> str:
    return f"static const double {what} = {{{', '.join(map(digits, values))}}};"
