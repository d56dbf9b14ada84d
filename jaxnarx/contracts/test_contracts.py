"""Every check of a kind over every extension of it, see `jaxnarx.contracts`."""

import functools
import inspect
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from jaxnarx.contracts import (
    analysis,
    candidate,
    engine,
    partition,
    reader,
    selector,
    target,
    validity,
)
from jaxnarx.data import KINDS
from jaxnarx.engines import BEDS
from jaxnarx.evaluation import ANALYSES
from jaxnarx.exporters import TARGETS
from jaxnarx.extensions import Registry
from jaxnarx.identification import CANDIDATES
from jaxnarx.models import VALIDITIES
from jaxnarx.settings import PARTITIONS, SELECTORS


@functools.cache
def engine_and_records(name: str) -> tuple[Any, ...]:
    """The engine and its records, which are simulated once."""
    bed = BEDS[name]()
    return bed, engine.usual(bed)


def make_example(registry: Registry[Any], name: str) -> Any:
    """The object that the example of an extension makes."""
    example = registry.example(name)
    if example is None:
        pytest.fail(f"{name!r} is registered without the example that its checks need")
    return example


KINDS_OF_EXTENSIONS: tuple[tuple[Registry[Any], Any, Callable[[str], Any]], ...] = (
    (VALIDITIES, validity, lambda name: make_example(VALIDITIES, name)()),
    (SELECTORS, selector, lambda name: (SELECTORS[name],)),
    (
        PARTITIONS,
        partition,
        lambda name: (PARTITIONS[name], make_example(PARTITIONS, name)()),
    ),
    (CANDIDATES, candidate, lambda name: (CANDIDATES[name],)),
    (ANALYSES, analysis, lambda name: (ANALYSES[name],)),
    (BEDS, engine, engine_and_records),
    (KINDS, reader, lambda name: (make_example(KINDS, name), name)),
    (TARGETS, target, lambda name: (TARGETS[name],)),
)
"""Every registry, the module of its checks, and what these are given first."""


def cases() -> Iterator[Any]:
    """One for every extension and check."""
    for registry, module, given in KINDS_OF_EXTENSIONS:
        for name in registry.added:
            for check in module.CHECKS:
                told = f"{module.__name__.rpartition('.')[2]}-{name}-{check.__name__}"
                yield pytest.param(check, given, name, id=told)


@pytest.mark.parametrize(("check", "given", "name"), list(cases()))
def test_an_extension(check, given, name, tmp_path):
    """The rule is the docstring of the check."""
    wants_folder = "folder" in inspect.signature(check).parameters
    check(*given(name), *(tmp_path,) * wants_folder)
