"""Run-time checks of types and shapes at every call, each of them once.

`jaxtyping.jaxtyped` binds the arguments of each call by Python and has all of them
checked twice, whatever they are. Here the typechecker wraps the function itself, and
axes have a scope of their own only where an annotation names shapes. What has no
annotation is not touched: of a nested function every call of the outer one would
compile the checks anew.
"""

import functools
import inspect
from collections.abc import Callable, Iterator
from typing import Any, get_args

import jaxtyping
from beartype import BeartypeConf, beartype

_jaxtyped: Callable[..., Any] = jaxtyping.jaxtyped
plain = beartype(conf=BeartypeConf(violation_type=jaxtyping.TypeCheckError))


def install() -> None:
    """To be called before the package is imported."""
    jaxtyping.jaxtyped = checked
    jaxtyping.install_import_hook("jaxnarx", "beartype.beartype")


def checked(*, typechecker: Any) -> Callable[[Any], Any]:
    def decorate(definition: Any) -> Any:
        if inspect.isclass(definition):
            return _jaxtyped(definition, typechecker=typechecker)
        hints = list(getattr(definition, "__annotations__", {}).values())
        if not hints:
            return definition
        parts = [part for hint in hints for part in _parts(hint)]
        if any(isinstance(part, str) for part in parts):
            # a type that is text until somebody imports it
            return _jaxtyped(definition, typechecker=typechecker)
        shapes = any(getattr(part, "__module__", "") == "jaxtyping" for part in parts)
        return _scoped(plain(definition)) if shapes else plain(definition)

    return decorate


def _scoped(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` with axes of its own."""

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        with _jaxtyped("context"):
            return function(*args, **kwargs)

    return call


def _parts(hint: Any) -> Iterator[Any]:
    """A hint and everything inside of it."""
    yield hint
    for part in hint if isinstance(hint, list) else get_args(hint):
        yield from _parts(part)
