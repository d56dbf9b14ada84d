"""The candidates of `recovery.py`; standard library only, for every interpreter.

All terms up to degree 2 in lags 1 to 4 of four inputs and lags 1 and 2 of the output:
18 variables, 190 terms with the constant.
"""

from collections.abc import Iterable

INPUTS = ("u1", "u2", "u3", "u4")
INPUT_LAGS, OUTPUT_LAGS, DEGREE = (1, 2, 3, 4), (1, 2), 2
HISTORY = max(INPUT_LAGS + OUTPUT_LAGS)


def name(variables: Iterable[str]) -> str:
    """A product's text, its factors in alphabetical order; "1" for the empty one."""
    return "*".join(sorted(variables)) or "1"
