"""Formulas by which channels of MDF files are converted, without running their text.

A formula holds `X` or `X1` (the stored number), numbers, `+ - * / **`, brackets and the
functions below. asammdf hands it to evaluators of Python code and returns the stored
numbers where these fail; here it is read as a tree of known operations, or refused.
`^` is refused: it is a power to some programs and an exclusive or to others.
"""

import ast
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

LONGEST_FORMULA = 2000
"""Characters of a formula that is read."""
MOST_OPERATIONS = 500
"""Operations of a formula: each is one pass over the samples."""

Values = Float[np.ndarray, " time"]

_OPERATORS: dict[type, Callable] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.float_power,
    ast.UAdd: np.positive,
    ast.USub: np.negative,
}
_FUNCTIONS: dict[str, tuple[int, Callable]] = {
    "pow": (2, np.float_power),
    "power": (2, np.float_power),
    "atan2": (2, np.arctan2),
    "arctan2": (2, np.arctan2),
    "abs": (1, np.abs),
    "sqrt": (1, np.sqrt),
    "exp": (1, np.exp),
    "ln": (1, np.log),
    "log": (1, np.log),
    "log10": (1, np.log10),
    "sin": (1, np.sin),
    "cos": (1, np.cos),
    "tan": (1, np.tan),
    "asin": (1, np.arcsin),
    "acos": (1, np.arccos),
    "atan": (1, np.arctan),
    "arcsin": (1, np.arcsin),
    "arccos": (1, np.arccos),
    "arctan": (1, np.arctan),
    "sinh": (1, np.sinh),
    "cosh": (1, np.cosh),
    "tanh": (1, np.tanh),
    "floor": (1, np.floor),
    "ceil": (1, np.ceil),
}
_CONSTANTS = {"pi": np.pi, "inf": np.inf, "nan": np.nan}


def apply_formula(formula: str, x: Values) -> Values:
    """The converted samples; ValueError that says what in the formula is not known.

    Samples for which the formula has no finite value, such as the logarithm of a
    negative number, are NaN.
    """
    tree = _parse(formula)
    with np.errstate(all="ignore"):
        found = _value(tree, np.asarray(x, np.float64))
    converted = np.broadcast_to(np.asarray(found, np.float64), np.shape(x))
    return np.where(np.isfinite(converted), converted, np.nan)


def _parse(formula: str) -> ast.expr:
    if len(formula) > LONGEST_FORMULA:
        raise ValueError(f"it has {len(formula):,} characters")
    if "^" in formula:
        raise ValueError("^ may mean a power or an exclusive or")
    try:
        tree = ast.parse(formula.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError("it cannot be read") from None
    if sum(1 for _ in ast.walk(tree)) > 4 * MOST_OPERATIONS:
        raise ValueError(f"it has more than {MOST_OPERATIONS} operations")
    return tree


def _value(node: ast.expr, x: Values) -> Values | float:
    match node:
        case ast.Constant(value=bool() | complex()):
            pass
        case ast.Constant(value=int() | float() as number):
            return np.float64(number)
        case ast.Name(id=name) if name.upper() in ("X", "X1"):
            return x
        case ast.Name(id=name) if name.lower() in _CONSTANTS:
            return _CONSTANTS[name.lower()]
        case ast.BinOp(left=a, op=op, right=b) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_value(a, x), _value(b, x))
        case ast.UnaryOp(op=op, operand=a) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_value(a, x))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            count, function = _FUNCTIONS.get(name.lower(), (-1, None))
            if function is not None and len(args) == count:
                return function(*(_value(a, x) for a in args))
    raise ValueError(f"{ast.unparse(node)[:40]!r} is not known")
