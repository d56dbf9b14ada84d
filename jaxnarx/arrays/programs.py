"""Compiled functions of models: names of channels are no part of a program."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx

R = TypeVar("R")


def program(function: Callable[..., R]) -> Callable[..., R]:
    """`equinox.filter_jit` for functions that take models.

    An argument that has a `nameless` twin, equal but for the names that it carries as
    static data, is replaced by that: other names compile nothing anew. So the function
    may return arrays, but no model. Arrays of numpy may be given for those of jax.
    """
    compiled = eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> R:
        named = {k: plain(a) for k, a in kwargs.items()}
        return compiled(*(plain(a) for a in args), **named)

    return call


def plain(value: Any) -> Any:
    """The twin without names, or the value itself; tuples by their elements."""
    if type(value) is tuple:
        return tuple(plain(v) for v in value)
    return getattr(value, "nameless", value)


def twin(module: Any, **fields: Any) -> Any:
    """A copy of a module with other values in these fields, unchecked and cheap."""
    copy = object.__new__(type(module))
    for name, value in (vars(module) | fields).items():
        object.__setattr__(copy, name, value)
    return copy
