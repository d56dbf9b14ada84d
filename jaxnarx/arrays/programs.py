"""Compiled functions of models: names of channels are no part of a program."""

import functools
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
from jax.core import Tracer

R = TypeVar("R")

ARRAY_MARK = object()
"""In place of an array among what is static."""
MEMORY_MAP_FILES, MOST_MAPS = (
    Path("/proc/self/maps"),
    Path("/proc/sys/vm/max_map_count"),
)
"""Memory maps of this process and how many it may have, where the system tells; every
compiled program has about ten, and the compiler ends the process when none is left."""
MAX_MAP_SHARE = 0.6
"""Share of the memory maps that may be in use."""
PROGRAMS_BETWEEN_CHECKS = 50
"""New programs between looks at their number."""
QUICK_OPTIONS = {"xla_cpu_use_fusion_emitters": False}
"""The compiler's former generator of code for the CPU. A network of hidden states and
its training were compiled in 9 s, not in 15; runs of polynomials take a fifth longer,
loops as long (jax 0.10)."""
MOST_QUICK_ENTRIES = 500_000
"""Entries of all arrays of a program up to which compilation takes longer than what it
saves: some 10,000 samples of 50 columns."""
OPTIONS_WITHIN, UNKNOWN_OPTION = "`compiler_options`", "No such compile option"
"""jax refuses options of a program within another, and unknown ones, in these words."""
_made = itertools.count(1)
_knows_options = [True]
"""Empty where the compiler does not know `QUICK_OPTIONS`."""


def program(function: Callable[..., R]) -> Callable[..., R]:
    """`equinox.filter_jit` for functions that take models.

    An argument that has a `nameless` twin, equal but for the names that it carries as
    static data, is replaced by that: other names compile nothing anew. So the function
    may return arrays, but no model. Arrays of numpy may be given for those of jax.
    """

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> R:
        return bind(function, *args, **kwargs)()

    return call


def bind(function: Callable[..., R], *args: Any, **kwargs: Any) -> Callable[..., R]:
    """The program of a function with its first arguments given, as `program` takes
    them; the others are arrays, or trees of them.

    Static arguments are examined once, not in every call: that costs as much as a run
    of a few hundred samples.
    """
    named = {k: strip_names(a) for k, a in kwargs.items()}
    leaves, tree = jax.tree.flatten((tuple(strip_names(a) for a in args), named))
    flags = [eqx.is_array(leaf) for leaf in leaves]
    pairs = list(zip(leaves, flags, strict=True))
    static = tuple(ARRAY_MARK if flag else leaf for leaf, flag in pairs)
    # 1, 1.0 and True are equal, but make different programs.
    asked = function, tree, static, tuple(map(type, static))
    arrays = [leaf for leaf, flag in pairs if flag]
    if _knows_options and _is_small(arrays):
        return functools.partial(_run_quickly, asked, arrays)
    return functools.partial(_compile(*asked), arrays)


def _run_quickly(asked: tuple, arrays: list, *more: Any) -> Any:
    """A small program, compiled quickly: not one within another, which cannot have
    options of its own, and not by a compiler that does not know them."""
    try:
        return _compile(*asked, quick=True)(arrays, *more)
    except (ValueError, jax.errors.JaxRuntimeError) as error:
        if UNKNOWN_OPTION in str(error):
            _knows_options.clear()
        elif OPTIONS_WITHIN not in str(error):
            raise
        return _compile(*asked)(arrays, *more)


def _is_small(arrays: list) -> bool:
    """Whether no array is traced, and all together are small."""
    entries = 0
    for array in arrays:
        if isinstance(array, Tracer):
            return False
        entries += array.size
    return entries <= MOST_QUICK_ENTRIES


@functools.lru_cache(maxsize=4096)
def _compile(
    function: Callable, tree: Any, static: tuple, kinds: tuple, *, quick: bool = False
) -> Callable:
    """The program of a function whose arrays are arguments, in one list."""
    del kinds
    if next(_made) % PROGRAMS_BETWEEN_CHECKS == 0 and is_crowded():
        _compile.cache_clear()
        jax.clear_caches()

    @functools.partial(jax.jit, compiler_options=QUICK_OPTIONS if quick else None)
    @functools.wraps(function, updated=())
    def run(arrays: list, *more: Any):
        given = iter(arrays)
        leaves = [next(given) if leaf is ARRAY_MARK else leaf for leaf in static]
        args, kwargs = jax.tree.unflatten(tree, leaves)
        return function(*args, *more, **kwargs)

    return run


def is_crowded() -> bool:
    """Whether so many programs are held that there is little room for others."""
    try:
        with MEMORY_MAP_FILES.open("rb") as maps:
            held = sum(1 for _ in maps)
        return held > MAX_MAP_SHARE * int(MOST_MAPS.read_text())
    except (OSError, ValueError):
        return False


def strip_names(value: Any) -> Any:
    """The twin without names, or the value itself; tuples by their elements."""
    if type(value) is tuple:
        return tuple(strip_names(v) for v in value)
    return getattr(value, "nameless", value)


def twin(module: Any, **fields: Any) -> Any:
    """A copy of a module with other values in these fields, unchecked and cheap."""
    copy = object.__new__(type(module))
    for name, value in (vars(module) | fields).items():
        object.__setattr__(copy, name, value)
    return copy
