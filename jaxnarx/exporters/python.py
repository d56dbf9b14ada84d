"""A page of Python without dependencies."""

import keyword
from string import Template

from jaxnarx.checks import require
from jaxnarx.exporters.code import INFIX_TEMPLATES, Syntax, comment, digits
from jaxnarx.exporters.form import ParameterTable, SampleProgram
from jaxnarx.exporters.scripts import Language, number, sources, write_page
from jaxnarx.exporters.target import Files, Golden


def python_files(program: SampleProgram, golden: Golden) -> Files:
    """A module with the class `Model`, by its name; no golden vectors go with it."""
    del golden
    name = program.name
    require(not keyword.iskeyword(name), "name", f"name {name!r} is a word of Python")
    return {f"{name}.py": write_page(program, PYTHON)}


def _syntax(program: SampleProgram) -> Syntax:
    del program
    return Syntax(
        source=sources("self.{name}", "self.{name}", 0, "[{}]"),
        operation=INFIX_TEMPLATES
        | {
            "max": "{0} if {0} > {1} else {1}",
            "min": "{0} if {0} < {1} else {1}",
            "less": "1.0 if {0} < {1} else 0.0",
            "where": "{1} if {0} > 0.5 else {2}",
            "exp": "_exp({0})",
            "sqrt": "math.sqrt({0})",
        },
        number=number("math.nan", "math.inf"),
        assign="{name} = {value}",
    )


def _table(table: ParameterTable) -> list[str]:
    numbers = ", ".join(digits(x) for x in table.values.ravel())
    return [f"    # {comment(table.about)}", f"    {table.name} = [{numbers}]"]


PYTHON = Language(
    page=Template('''"""$about

    model = Model()
    model.start("steady", u)     # or "mean", "zeros", or "given" and outputs y
    model.observe(u, y)          # for every sample of measured history, if any
    y = model.step(u)            # for every sample of the free run

A run starts at its first inputs, as if they had been so for ever: in the steady state
there, with outputs in the middle of their trained ranges, at zero, or as given.
Physical units; limited, fed and the flags are of the last step.
$notes
"""

import math

SAMPLE_TIME = $sample_time
HISTORY = $history
INPUTS = $inputs
OUTPUTS = $outputs
REPORTED = $reported
MIDDLE = $middle
WIDTH = $width


def _exp(x):
    return math.exp(x) if x < 709.0 else math.inf


class Model:
$tables

    def __init__(self):
$fields
        self.limited = [0.0] * len(OUTPUTS)
        self.fed = [0.0] * len(OUTPUTS)
$no_flags

    def start(self, kind, u, y=None):
        """Begin a run at its first inputs; see the module."""
        if kind == "steady":
            self.settle(u)
        elif kind == "mean":
            self.begin(u, MIDDLE)
        elif kind == "zeros":
            self.begin(u, [0.0] * len(OUTPUTS))
        elif kind == "given" and y is not None:
            self.begin(u, y)
        else:
            raise ValueError("start: steady, mean, zeros, or given with outputs")

    def settle(self, u):
        """Begin in the steady state; returns how many samples it took to find."""
        self.begin(u, MIDDLE)
        before, still = MIDDLE, 0
        for n in range($longest):
            self.step(u)
            pairs = zip(self.fed, before, WIDTH)
            rests = all(abs(a - b) <= $settled * w for a, b, w in pairs)
            still = still + 1 if rests else 0
            if still > 10:
                return n
            before = self.fed
        return $longest

    def begin(self, u, y):
        """As if inputs and outputs had been so for ever."""
$begin

    def observe(self, u, y):
        """A sample of measured history."""
$observe

    def step(self, u):
        """The outputs of a sample of the free run."""
$step
        self.limited = $limited
        self.fed = $fed
$flags
        reported = $values
$keep
        return reported
'''),
    syntax=_syntax,
    own="self.{name}",
    flag="self.{name}",
    fresh="[0.0] * {length}",
    filled="[{value}] * {length}",
    entered="{line} = [{value}, *{line}[:-1]]",
    set="{name} = {value}",
    row="[{items}]",
    table=_table,
    indent=" " * 8,
)
"""Lists of floats; what is kept are attributes of an instance."""
