"""The number type of a process, to be the same wherever a sweep is computed."""

import importlib
from contextlib import AbstractContextManager
from typing import Any

import jax


def is_float64() -> bool:
    """Whether jax computes with 64 bits in this thread."""
    return bool(getattr(jax.config, "jax_enable_x64"))  # noqa: B009


def number_type(float64: bool) -> AbstractContextManager[Any]:
    """jax's own context, for this thread: the process may have tasks of others."""
    context = getattr(jax, "enable_x64", None)
    if context is None:  # before jax 0.8
        experimental = importlib.import_module("jax.experimental")
        context = experimental.enable_x64
    return context(float64)
