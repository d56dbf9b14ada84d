"""A selection as people read it: terms, coefficients, how sure they are."""

from collections.abc import Sequence

import numpy as np
import scipy.special

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import whole
from jaxnarx.selection.selection import Selection

Numbers = Sequence[float | None] | np.ndarray

COLUMN_STYLES = (
    (100, ".5f", 10),
    (1, ".6g", 13),
    (1, ".3g", 11),
    (1, ".2f", 9),
    (1, ".2g", 9),
)
"""Factor, form and width of ERR, coefficient, standard error, t and p."""


@guard_arguments
def coefficient_table(selection: Selection, output: int = 0) -> str:
    """Terms in order of choice with ERR, coefficient, standard error, t and p.

    Coefficients and standard errors are in physical units, of the output's unit over
    those of the term's factors. t and p test each coefficient in the model as it is;
    they know nothing of the search that chose it, which makes small p look smaller.
    """
    output = whole(output, "output", 0, len(selection.index) - 1)
    pool, terms = selection.pool, selection.terms(output)
    signal = [s for s, _ in pool.variables]
    scale = np.concatenate([[1.0], selection.gain[signal]])
    own = selection.gain[len(pool.channels.inputs) + pool.outputs[output]]
    spare = max(int(selection.samples[output]) - len(terms), 1)
    unit = own / np.prod(scale[pool.factor[terms]], axis=1)
    value = selection.coefficient[output, : len(terms)] * unit
    error = selection.error[output, : len(terms)] * unit
    t = np.divide(value, error, where=error > 0, out=np.full(len(terms), np.inf))
    p = 2.0 * scipy.special.stdtr(spare, -np.abs(t))
    title = (
        f"{selection.output_names[output]}: {int(selection.samples[output])} samples"
    )
    names = [pool.name(term) for term in terms]
    err = selection.err[output, : len(terms)]
    return "\n".join([title, *coefficient_lines(names, value, error, t, p, err)])


def coefficient_lines(
    names: Sequence[str],
    value: Numbers,
    error: Numbers,
    t: Numbers,
    p: Numbers,
    err: Numbers,
) -> list[str]:
    """A line of names and one for every coefficient; what is None shows as a dash.

    `err` is a share of one and shown in percent.
    """
    width = max([4, *map(len, names)])
    lines = [
        f"{'term':{width}s} {'ERR %':>10s} {'coefficient':>13s} {'std. error':>11s} "
        f"{'t':>9s} {'p':>9s}"
    ]
    for name, row in zip(names, zip(err, value, error, t, p, strict=True), strict=True):
        cells = [
            format("-" if x is None else format(x * factor, style), f">{size}")
            for x, (factor, style, size) in zip(row, COLUMN_STYLES, strict=True)
        ]
        lines.append(f"{name:{width}s} " + " ".join(cells))
    return lines
