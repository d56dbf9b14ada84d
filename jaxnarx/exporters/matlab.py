"""A MATLAB function with persistent state, and a script that tests it.

One function holds the state, so that a MATLAB Function block takes it as it is; what it
does beside a step stands in its second argument.
"""

import math
from collections.abc import Sequence
from string import Template

import numpy as np
from jaxtyping import Float

from jaxnarx.checks import require
from jaxnarx.exporters.code import INFIX_TEMPLATES, Syntax, comment, digits
from jaxnarx.exporters.form import ParameterTable, SampleProgram
from jaxnarx.exporters.interpret import MEAN, STEADY, ZEROS, Instance
from jaxnarx.exporters.scripts import Language, number, sources, write_page
from jaxnarx.exporters.target import Files, Golden

TAKEN_WORDS = frozenset(
    "abs all any begun break case catch clear compare double else elseif empty end "
    "error exp for fprintf function global if invalid isempty isnan length max min "
    "missing nan nargin observed ones otherwise parameters parfor persistent realmin "
    "repmat return settled size sqrt stepped struct switch true false try while "
    "zeros".split()
)
"""Words of the language, and of the page, that a function cannot be called."""
STARTED_SAMPLES = 10
"""Samples of every start that the script looks at."""
SETTLING_SAMPLES = 2000
"""Samples within which a steady state must be found for the script to look for it:
Octave takes a millisecond for one."""


def matlab_files(program: SampleProgram, golden: Golden) -> Files:
    """The function and its script; `golden` has the `inputs` and `measured` outputs of
    a stretch, and the `outputs` that are to come."""
    name = program.name
    require(
        name.lower() not in TAKEN_WORDS, "name", f"name {name!r} is a word of MATLAB"
    )
    flags = "".join(f", {flag}" for flag in program.flags)
    uses = {
        stage: _PARAMETERS_LINE
        if any(program.ops[n].kind == "table" for n in ops)
        else ""
        for stage, ops in (
            *(("begin_tables", program.begin), ("observe_tables", program.observe)),
            ("step_tables", program.step),
        )
    }
    places = {
        "flags_out": flags,
        "inputs_about": _ports("u", program.inputs),
        "outputs_about": _ports("y", program.computed),
        "count": str(len(program.computed)),
    }
    return {
        f"{name}.m": write_page(program, MATLAB, places | uses),
        f"{name}_test.m": _test(program, golden),
    }


_PARAMETERS_LINE = "    p = parameters();"


def _ports(letter: str, ports) -> str:
    return "\n".join(
        f"%   {letter}({k}) {comment(p.name + (f' [{p.unit}]' if p.unit else ''))}, "
        f"{p.low:.6g} to {p.high:.6g}"
        for k, p in enumerate(ports, start=1)
    )


def _syntax(program: SampleProgram) -> Syntax:
    def entry(at: tuple[str, int]) -> str:
        name, k = at
        place = np.unravel_index(k, program.table(name).values.shape)
        return f"p.{name}({', '.join(str(int(i) + 1) for i in place)})"

    return Syntax(
        source=sources("", "s.{name}", 1, "({})") | {"table": entry},
        operation=INFIX_TEMPLATES
        | {
            "max": "max({0}, {1})",
            "min": "min({0}, {1})",
            "less": "double({0} < {1})",
            "exp": "exp({0})",
            "sqrt": "sqrt({0})",
        },
        number=number("NaN", "Inf"),
        assign="{name} = {value};",
        statement={"where": "if {0} > 0.5, {name} = {1}; else, {name} = {2}; end"},
    )


def _matrix(name: str, rows: Float[np.ndarray, "rows columns"]) -> list[str]:
    """A matrix, a row on a line or, of long ones, on several."""
    lines = [f"{name} = [ ..."]
    for row in np.atleast_2d(rows):
        texts = ["NaN" if math.isnan(x) else digits(x) for x in row]
        parts = [", ".join(texts[k : k + 4]) for k in range(0, len(texts), 4)]
        lines.append("    " + ", ...\n        ".join(parts) + "; ...")
    return [*lines, "    ];"]


def _table(table: ParameterTable) -> Sequence[str]:
    matrix = _matrix(f"p.{table.name}", table.values.reshape(table.values.shape[0], -1))
    return ["    % " + comment(table.about), *(f"    {line}" for line in matrix)]


def _texts(names: Sequence[str]) -> str:
    return "{" + ", ".join("'" + n.replace("'", "''") + "'" for n in names) + "}"


def _test(program: SampleProgram, golden: Golden) -> str:
    inputs = golden["inputs"]
    matrices = [_matrix(k, golden[k]) for k in ("inputs", "measured")]
    matrices.append(_matrix("expected", golden["outputs"]))
    settles = samples_to_rest(program, inputs[0]) <= SETTLING_SAMPLES
    for kind in (STEADY, MEAN, ZEROS) if settles else (MEAN, ZEROS):
        instance = Instance(program)
        instance.start(kind, inputs[0])
        rows = [instance.step(u)["outputs"] for u in inputs[:STARTED_SAMPLES]]
        matrices.append(_matrix(f"from_{kind}", np.array(rows)))
    return _TEST_PAGE.substitute(
        name=program.name,
        steady=_STEADY_PAGE.substitute(name=program.name)
        if settles
        else _UNSETTLED_NOTE,
        history=program.history,
        matrices="\n".join(line for matrix in matrices for line in matrix),
    )


MATLAB = Language(
    page=Template("""function [y, limited$flags_out] = $name(u, kind, y0)
% $about
%
%   y = $name(u)            outputs of a sample of the free run, by its inputs
%   $name(u, 'steady')      start in the steady state at the first inputs u
%   $name(u, 'mean')        or with outputs in the middle of their trained ranges
%   $name(u, 'zeros')       or with outputs at zero
%   $name(u, 'given', y)    or with outputs y, all as if they had been so for ever
%   $name(u, 'observe', y)  behind 'given': one of $history samples of measured history
%   [y, limited$flags_out] = $name(u)   what was limited too, and flags
%
% Without a start a run begins in the steady state. With a second argument no sample
% goes by: y is what the step at u would give. In a MATLAB Function block, with a sample
% time of $sample_time s, y = $name(u) is all there is to write.
% Physical units; what was trained:
$inputs_about
$outputs_about
$notes
%#codegen
persistent s
middle = $middle;
if isempty(s)
    s = begun(u, middle);
    if nargin < 2
        s = settled(u, middle);
    end
end
if nargin > 1
    switch kind
        case 'steady'
            s = settled(u, middle);
        case 'mean'
            s = begun(u, middle);
        case 'zeros'
            s = begun(u, zeros($count, 1));
        case 'given'
            s = begun(u, y0);
        case 'observe'
            s = observed(s, u, y0);
        otherwise
            error('$name: steady, mean, zeros, given or observe');
    end
end
[next, y, limited, fed$flags_out] = stepped(s, u);
if nargin < 2
    s = next;
end
end

function s = settled(u, middle)
% Where the free run comes to rest from the middle of the trained ranges.
width = $width;
s = begun(u, middle);
before = middle;
still = 0;
for n = 1:$longest
    [s, y, limited, fed] = stepped(s, u);
    if all(abs(fed - before) <= $settled * width)
        still = still + 1;
    else
        still = 0;
    end
    if still > 10
        break
    end
    before = fed;
end
end

function s = begun(u, y)
% As if inputs and outputs had been so for ever.
    s = empty();
$begin_tables
$begin
end

function s = observed(s, u, y)
% A sample of measured history.
$observe_tables
$observe
end

function [s, y, limited, fed$flags_out] = stepped(s, u)
% A sample of the free run.
$step_tables
$step
    y = $values;
    limited = $limited;
    fed = $fed;
$flags
$keep
end

function s = empty()
    s = struct();
$fields
end

function p = parameters()
    p = struct();
$tables
end
"""),
    syntax=_syntax,
    own="s.{name}",
    flag="{name}",
    fresh="zeros(1, {length})",
    filled="{value} * ones(1, {length})",
    entered="{line} = [{value}, {line}(1:end-1)];",
    set="{name} = {value};",
    row="[{items}]",
    table=_table,
    names=_texts,
    between="; ",
    remark="% ",
)
"""Columns of doubles; what is kept is a structure that functions hand on."""

_TEST_PAGE = Template("""function ${name}_test()
% Golden vectors: what the model does in its home. An error tells of a difference.
$matrices
clear $name
$name(inputs(1, :), 'given', measured(1, :));
for t = 1:$history
    $name(inputs(t, :), 'observe', measured(t, :));
end
compare('given', expected, 1e-11, inputs($history + 1:end, :));
$name(inputs(1, :), 'mean');
compare('mean', from_mean, 1e-11, inputs);
$name(inputs(1, :), 'zeros');
compare('zeros', from_zeros, 1e-11, inputs);
${steady}end

function compare(what, expected, tolerance, inputs)
found = zeros(size(expected));
for t = 1:size(expected, 1)
    found(t, :) = $name(inputs(t, :));
end
scale = max(max(abs(expected), [], 1), realmin);
off = abs(found - expected) ./ repmat(scale, size(expected, 1), 1);
off(isnan(found) & isnan(expected)) = 0;
if ~all(off(:) <= tolerance)
    error('$name: after the start %s it differs by %.3g', what, max(off(:)));
end
fprintf('%s: differs by %.3g of the largest value\\n', what, max(off(:)));
end
""")
_STEADY_PAGE = Template("clear $name\ncompare('steady', from_steady, 1e-8, inputs);\n")
"""The sample at which a steady state is found depends on rounding, by one."""
_UNSETTLED_NOTE = (
    f"% 'steady' takes more than {SETTLING_SAMPLES} samples: it is not tried here.\n"
)


def samples_to_rest(
    program: SampleProgram, inputs: Float[np.ndarray, " inputs"]
) -> int:
    """Samples that the steady state at these inputs takes to be found."""
    return int(Instance(program).settle(inputs))
