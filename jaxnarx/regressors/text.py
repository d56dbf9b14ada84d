"""Variables, terms and equations as people read them, and back.

Strings exist at the surface only: tables are what the program computes with. The parser
knows one form, `name[t-3]`, in which a filter may stand for the name; nothing is ever
evaluated.
"""

import re
from collections.abc import Sequence

import numpy as np

from jaxnarx.data import Channels
from jaxnarx.errors import SpecError
from jaxnarx.regressors._filter_text import WRITTEN_FORMS, filter_text, parse_filter
from jaxnarx.regressors.filters import AbstractFilter
from jaxnarx.regressors.variables import Entry, Variables

_LAG_PATTERN = re.compile(
    r"^(?P<name>.+)\[\s*t\s*(?:-\s*(?P<lag>\d{1,6})\s*)?\]$", re.DOTALL
)


def variable_name(
    channels: Channels, signal: int, lag: int, filter_: AbstractFilter | None = None
) -> str:
    """Text of a variable: `speed[t-3]`, or `speed[t]` at lag 0; `lp(speed, 4 s)[t]` of
    a filtered one."""
    name = channels.names[signal]
    if filter_ is not None:
        name = filter_text(filter_, name)
    return f"{name}[t-{lag}]" if lag else f"{name}[t]"


def variable_names(channels: Channels, variables: Variables) -> list[str]:
    """Texts of all lagged variables."""
    return [variable_name(channels, *entry) for entry in variables.entries]


def parse_variable(channels: Channels, text: str) -> Entry:
    """(signal, lag, filter or None) of `"speed[t-3]"` or `"lp(speed, 4 s)[t]"`.

    The exact name of a channel wins, whatever it looks like. Unknown names and other
    forms raise SpecError.
    """
    match = _LAG_PATTERN.match(text.rstrip())
    if match is None:
        raise SpecError(
            f"{text!r} is not a lagged variable; write 'name[t]' or 'name[t-3]', or of "
            f"a filtered one {WRITTEN_FORMS} in place of the name",
            field="scheduling",
        )
    name, filter_ = match["name"], None
    if name not in channels.names and name.strip() not in channels.names:
        found = parse_filter(name, channels.names)
        name, filter_ = found if found is not None else (name, None)
    signal = channels.signal(name if name in channels.names else name.strip())
    lag = int(match["lag"] or 0)
    if lag == 0 and signal >= len(channels.inputs):
        raise SpecError(
            f"{text!r}: an output cannot be used at lag 0, it is what the model "
            "computes; use an earlier sample such as "
            f"'{match['name']}[t-1]'",
            field="scheduling",
        )
    return signal, lag, filter_


def _powers(factors: Sequence[int]) -> list[tuple[int, int]]:
    """(variable, power) of a term's row, zeros left out, in order of the row."""
    nonzero = [int(f) for f in factors if f]
    return [(v, nonzero.count(v)) for v in dict.fromkeys(nonzero)]


def term_name(variables: Sequence[str], factors: Sequence[int]) -> str:
    """Text of a term: `"1"` for the constant, else `u1[t-2]*NOx[t-1]`, repeated factors
    as powers."""
    parts = [
        variables[v - 1] + (f"^{power}" if power > 1 else "")
        for v, power in _powers(factors)
    ]
    return "*".join(parts) or "1"


_LATEX_SPECIALS = {
    "\\": r"\backslash ",
    "_": r"\_",
    "%": r"\%",
    "&": r"\&",
    "#": r"\#",
    "$": r"\$",
    "{": r"\{",
    "}": r"\}",
    "^": r"\hat{}",
    "~": r"\sim ",
    " ": r"\ ",
}


def latex_variable(name: str) -> str:
    """`speed[t-3]` as LaTeX mathematics, special characters escaped."""
    stem, _, time = name.rpartition("[")
    escaped = "".join(_LATEX_SPECIALS.get(c, c) for c in stem)
    return rf"\mathrm{{{escaped}}}({time.rstrip(']').strip()})"


def latex_term(variables: Sequence[str], factors: Sequence[int]) -> str:
    """A term as LaTeX; the constant is the empty string."""
    return r"\,".join(
        latex_variable(variables[v - 1]) + (f"^{{{power}}}" if power > 1 else "")
        for v, power in _powers(factors)
    )


def latex_number(value: float) -> str:
    """Six significant digits, powers of ten as such."""
    mantissa, _, exponent = f"{value:.6g}".partition("e")
    return mantissa + (rf"\cdot 10^{{{int(exponent)}}}" if exponent else "")


def equation(
    output: str,
    variables: Sequence[str],
    terms: Sequence[Sequence[int]] | np.ndarray,
    coefficients: Sequence[float] | np.ndarray,
    *,
    style: str = "text",
) -> str:
    """`NOx[t] = 0.93 NOx[t-1] - 0.2 speed[t]*load[t]`; `style` is "text" or "latex"."""
    parts = []
    for factors, coefficient in zip(terms, coefficients, strict=True):
        sign = " - " if coefficient < 0 else " + "
        size = abs(float(coefficient))
        if style == "latex":
            body = latex_term(variables, factors)
            text = latex_number(size) + (rf"\,{body}" if body else "")
        else:
            body = term_name(variables, factors)
            text = f"{size:.6g}" + (f" {body}" if body != "1" else "")
        parts.append((sign, text))
    left = latex_variable(f"{output}[t]") if style == "latex" else f"{output}[t]"
    if not parts:
        return f"{left} = 0"
    first_sign = "-" if parts[0][0] == " - " else ""
    return f"{left} = {first_sign}{parts[0][1]}" + "".join(s + t for s, t in parts[1:])
