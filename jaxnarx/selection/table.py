"""A selection as people read it: terms, coefficients, how sure they are."""

import numpy as np
import scipy.special

from jaxnarx.selection.selection import Selection


def coefficient_table(selection: Selection, output: int = 0) -> str:
    """Terms in order of choice with ERR, coefficient, standard error, t and p.

    Coefficients and standard errors are in physical units, of the output's unit over
    those of the term's factors. t and p test each coefficient in the model as it is;
    they know nothing of the search that chose it, which makes small p look smaller.
    """
    pool, terms = selection.pool, selection.terms(output)
    signal = [s for s, _ in pool.variables]
    scale = np.concatenate([[1.0], selection.gain[signal]])
    own = selection.gain[len(pool.channels.inputs) + pool.outputs[output]]
    spare = max(int(selection.samples[output]) - len(terms), 1)
    width = max([4, *(len(pool.name(t)) for t in terms)])
    lines = [
        f"{selection.output_names[output]}: {int(selection.samples[output])} samples",
        f"{'term':{width}s} {'ERR %':>10s} {'coefficient':>13s} {'std. error':>11s} "
        f"{'t':>9s} {'p':>9s}",
    ]
    for slot, term in enumerate(terms):
        unit = own / np.prod(scale[pool.factor[term]])
        value, error = (
            selection.coefficient[output, slot],
            selection.error[output, slot],
        )
        t = value / error if error > 0 else np.inf
        p = 2.0 * scipy.special.stdtr(spare, -abs(t))
        lines.append(
            f"{pool.name(term):{width}s} {100 * selection.err[output, slot]:10.5f} "
            f"{value * unit:13.6g} {error * unit:11.3g} {t:9.2f} {p:9.2g}"
        )
    return "\n".join(lines)
