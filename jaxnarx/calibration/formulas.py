"""Formulas of signals, read as trees of known operations and never run as programs."""

import ast
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax.numpy as jnp

from jaxnarx.errors import SpecError
from jaxnarx.settings import Calibratable, CycleLimit, Measure

LONGEST = 500
"""Letters of a formula at most."""
_OPERATORS: dict[type, Callable] = {
    ast.Add: jnp.add,
    ast.Sub: jnp.subtract,
    ast.Mult: jnp.multiply,
    ast.Div: jnp.divide,
    ast.Pow: jnp.power,
    ast.UAdd: jnp.positive,
    ast.USub: jnp.negative,
}
_FUNCTIONS: dict[str, Callable] = {
    "abs": jnp.abs,
    "sqrt": jnp.sqrt,
    "exp": jnp.exp,
    "log": jnp.log,
    "max": jnp.maximum,
    "min": jnp.minimum,
}


def evaluate(formula: str, signal: Callable[[str], Any]) -> Any:
    """The value of a formula of signals; pure where these are arrays."""
    text, quoted = _replace_quoted(formula)
    return _value(_parse(text), lambda name: signal(quoted.get(name, name)))


def names_of(formula: str) -> list[str]:
    """The signals that a formula looks at; SpecError where it cannot be read."""
    text, quoted = _replace_quoted(formula)
    return list(dict.fromkeys(quoted.get(n, n) for n in _names(_parse(text))))


def signals_of(
    maps: Mapping[str, Calibratable],
    objective: Sequence[Measure],
    limits: Sequence[CycleLimit],
) -> list[str]:
    """Signals that maps go over, and that measures look at."""
    found = [s for m in maps.values() for s in m.over]
    for m in (*objective, *(one.measure for one in limits)):
        found += names_of(m.of) + (names_of(m.target) if m.target else [])
    return list(dict.fromkeys(found))


def _replace_quoted(formula: str) -> tuple[str, dict[str, str]]:
    """The formula with words in place of names in backticks, and these names."""
    found: dict[str, str] = {}

    def put(match: re.Match[str]) -> str:
        found[word := f"quoted_{len(found)}"] = match[1]
        return word

    return re.sub(r"`([^`]+)`", put, formula), found


def _parse(formula: str) -> ast.expr:
    if len(formula) > LONGEST:
        raise SpecError(
            f"a formula has {len(formula)} letters, {LONGEST} at most", field="of"
        )
    try:
        tree = ast.parse(formula.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise SpecError(f"formula {formula!r} cannot be read", field="of") from None
    for node in ast.walk(tree):
        _check(formula, node)
    return tree


def _check(formula: str, node: ast.AST) -> None:
    """SpecError at what is no signal, number, operation or function."""
    fine = isinstance(node, ast.Name | ast.expr_context | ast.operator | ast.unaryop)
    if isinstance(node, ast.Constant):
        fine = isinstance(node.value, int | float) and not isinstance(node.value, bool)
    elif isinstance(node, ast.BinOp | ast.UnaryOp):
        fine = type(node.op) in _OPERATORS
    elif isinstance(node, ast.Call):
        known = isinstance(node.func, ast.Name) and node.func.id in _FUNCTIONS
        two = known and node.func.id in ("max", "min")  # pyright: ignore
        fine = known and len(node.args) == 1 + two and not node.keywords
    if not fine:
        raise SpecError(
            f"formula {formula!r} may hold names of signals, numbers, + - * / ** and "
            f"{', '.join(_FUNCTIONS)}, nothing else",
            field="of",
        )


def _names(node: ast.expr) -> Iterator[str]:
    match node:
        case ast.Name(id=name):
            yield name
        case ast.BinOp(left=left, right=right):
            yield from _names(left)
            yield from _names(right)
        case ast.UnaryOp(operand=inner):
            yield from _names(inner)
        case ast.Call(args=args):
            for inner in args:
                yield from _names(inner)


def _value(node: ast.expr, signal: Callable[[str], Any]) -> Any:
    match node:
        case ast.Constant(value=number):
            return number
        case ast.Name(id=name):
            return signal(name)
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATORS[type(op)](_value(left, signal), _value(right, signal))
        case ast.UnaryOp(op=op, operand=inner):
            return _OPERATORS[type(op)](_value(inner, signal))
        case ast.Call(func=ast.Name(id=name), args=args):
            return _FUNCTIONS[name](*(_value(a, signal) for a in args))
    raise AssertionError("checked before")
