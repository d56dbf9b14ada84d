"""A JavaScript module without dependencies."""

from string import Template

from jaxnarx.exporters.code import INFIX_TEMPLATES, Syntax, comment, digits
from jaxnarx.exporters.form import ParameterTable, SampleProgram
from jaxnarx.exporters.scripts import Language, number, sources, write_page
from jaxnarx.exporters.target import Files, Golden


def javascript_files(program: SampleProgram, golden: Golden) -> Files:
    """A module with the class `Model`, by its name; no golden vectors go with it."""
    del golden
    return {f"{program.name}.mjs": javascript(program)}


def javascript(program: SampleProgram) -> str:
    """The module as text."""
    return write_page(program, JAVASCRIPT)


def _syntax(program: SampleProgram) -> Syntax:
    del program
    return Syntax(
        source=sources("TABLES.{name}", "this.{name}", 0, "[{}]"),
        operation=INFIX_TEMPLATES
        | {
            "max": "{0} > {1} ? {0} : {1}",
            "min": "{0} < {1} ? {0} : {1}",
            "less": "{0} < {1} ? 1.0 : 0.0",
            "where": "{0} > 0.5 ? {1} : {2}",
            "exp": "Math.exp({0})",
            "sqrt": "Math.sqrt({0})",
        },
        number=number("NaN", "Infinity"),
        assign="const {name} = {value};",
    )


def _table(table: ParameterTable) -> list[str]:
    numbers = ", ".join(digits(x) for x in table.values.ravel())
    return [f"  // {comment(table.about)}", f"  {table.name}: [{numbers}],"]


JAVASCRIPT = Language(
    page=Template("""/* $about

   const model = new Model();
   model.start('steady', u);  or 'mean', 'zeros', or 'given' and outputs y
   model.observe(u, y);       for every sample of measured history, if any
   const y = model.step(u);   for every sample of the free run

   A run starts at its first inputs, as if they had been so for ever: in the steady
   state there, with outputs in the middle of their trained ranges, at zero, or as
   given. Physical units; limited, fed and the flags are of the last step.
$notes
*/
export const SAMPLE_TIME = $sample_time;
export const HISTORY = $history;
export const INPUTS = $inputs;
export const OUTPUTS = $outputs;
export const REPORTED = $reported;
export const MIDDLE = $middle;
export const WIDTH = $width;
export const TABLES = {
$tables
};

export class Model {
  constructor() {
$fields
    this.limited = [];
    this.fed = [];
$no_flags
  }
  start(kind, u, y) {
    if (kind === 'steady') this.settle(u);
    else if (kind === 'mean') this.begin(u, MIDDLE);
    else if (kind === 'zeros') this.begin(u, MIDDLE.map(() => 0.0));
    else if (kind === 'given' && y) this.begin(u, y);
    else throw new Error('start: steady, mean, zeros, or given with outputs');
  }
  settle(u) {
    this.begin(u, MIDDLE);
    let before = MIDDLE, still = 0;
    for (let n = 0; n < $longest; n++) {
      this.step(u);
      const was = before;
      const off = this.fed.map((a, k) => Math.abs(a - was[k]));
      still = off.every((d, k) => d <= $settled * WIDTH[k]) ? still + 1 : 0;
      if (still > 10) return n;
      before = this.fed;
    }
    return $longest;
  }
  begin(u, y) {
$begin
  }
  observe(u, y) {
$observe
  }
  step(u) {
$step
    this.limited = $limited;
    this.fed = $fed;
$flags
    const reported = $values;
$keep
    return reported;
  }
}
"""),
    syntax=_syntax,
    own="this.{name}",
    flag="this.{name}",
    fresh="new Array({length}).fill(0.0)",
    filled="new Array({length}).fill({value})",
    entered="{line}.unshift({value}), {line}.pop();",
    set="{name} = {value};",
    row="[{items}]",
    table=_table,
    remark="   ",
)
"""Arrays of numbers; what is kept are fields of an instance."""
