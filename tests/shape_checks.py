"""Run-time checks of types and shapes at the first calls of a test, each of them once.

What a test calls thousands of times is checked `FIRST` times: later calls seldom have
other shapes, and in code of many small steps the checks were a third of the time.

`jaxtyping.jaxtyped` binds the arguments of each call by Python and has all of them
checked twice, whatever they are. Here the typechecker wraps the function itself, and
axes have a scope of their own only where an annotation names shapes. What has no
annotation is not touched: of a nested function every call of the outer one would
compile the checks anew.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterator
from typing import Any, get_args

import jaxtyping
from beartype import BeartypeConf, beartype

FIRST = 50
"""Calls of each function that every test checks."""

_test = [0]

_jaxtyped: Callable[..., Any] = jaxtyping.jaxtyped
plain = beartype(conf=BeartypeConf(violation_type=jaxtyping.TypeCheckError))


def install() -> None:
    """To be called before the package is imported."""
    jaxtyping.jaxtyped = checked
    jaxtyping.install_import_hook("jaxnarx", "beartype.beartype")


def next_test() -> None:
    """Calls are counted anew."""
    _test[0] += 1


def checked(*, typechecker: Any) -> Callable[[Any], Any]:
    def decorate(definition: Any) -> Any:
        if inspect.isclass(definition):
            return _with_init(definition, typechecker)
        hints = list(getattr(definition, "__annotations__", {}).values())
        if not hints:
            return definition
        parts = [part for hint in hints for part in _parts(hint)]
        if any(isinstance(part, str) for part in parts):
            # a type that is text until somebody imports it
            return _at_first(
                lambda: _jaxtyped(definition, typechecker=typechecker), definition
            )
        shapes = any(getattr(part, "__module__", "") == "jaxtyping" for part in parts)

        def make() -> Callable[..., Any]:
            own = plain(definition)
            return _scoped(own) if shapes else own

        return _at_first(make, definition)

    return decorate


def _with_init(definition: Any, typechecker: Any) -> Any:
    """A class whose fields are checked when it is made, if it is a dataclass."""
    own = definition.__dict__.get("__init__")
    if dataclasses.is_dataclass(definition) and inspect.isfunction(own):
        setattr(  # noqa: B010 # a class that is frozen for others
            definition,
            "__init__",
            _at_first(lambda: _jaxtyped(own, typechecker=typechecker), own),
        )
    return definition


def _at_first(make: Callable[[], Callable[..., Any]], bare: Any) -> Any:
    """What `make` returns for the first calls of every test, then what it wraps.

    It is made at the very first: most functions are not called in most processes.
    """
    if not inspect.isfunction(bare):
        return make()
    careful: list[Callable[..., Any]] = []
    test, calls = -1, 0

    @functools.wraps(bare)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal test, calls
        if test != _test[0]:
            test, calls = _test[0], 0
        if calls >= FIRST:
            return bare(*args, **kwargs)
        calls += 1
        if not careful:
            careful.append(make())
        return careful[0](*args, **kwargs)

    return call


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
