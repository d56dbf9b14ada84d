"""Random arguments for every public verb: only own errors, in bounds of time."""

import inspect
import math
import sys
from functools import cache
from pathlib import Path

import jax
import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1]))

from test_argument_checks import FITTING, VERBS, nouns

import jaxnarx as jnx

pytestmark = pytest.mark.slow

LONG = {"identify", "run_sweep", "sweep.identify_each", "refine", "sweep.find_run"}
"""Verbs that compute for long where their arguments happen to fit."""


@cache
def odd():
    """Values of all kinds; few of them fit where they are put."""
    return [
        *nouns().values(),
        *(True, 0, -1, 2, 2**63, 10**30, 0.5, -0.0, math.nan, math.inf, 1e300, 1j),
        *("", "a", "y", "a[t]", "x" * 500, "no/such/folder/file", "\x00", "\ud800"),
        *(b"bytes", [], [1, "a"], ["a"], [["a"]], ("a", "y"), {}, {"a": None}, {1: 2}),
        *({"a", "y"}, range(3), slice(3), int, iter([1]), float("-inf")),
        *(np.zeros(0), np.array(["a", None]), np.full((2, 2), np.nan), np.array(3)),
        *(np.array([1, 2]), jax.numpy.ones(3), jax.random.key(0), Path("."), Path()),
    ]


@pytest.mark.parametrize("verb", sorted(set(VERBS) - LONG))
def test_a_verb_with_random_arguments(verb, battery, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    parameters = inspect.signature(VERBS[verb]).parameters
    fitting = {n: nouns()[k] for n, k in FITTING.items()}
    fitting |= {"path": tmp_path / "f", "folder": tmp_path / "g"}

    def attempt(rng):
        given = {
            name: fitting[name]
            for name, p in parameters.items()
            if name in fitting and (p.default is p.empty or rng.random() < 0.2)
        }
        needed = [n for n, p in parameters.items() if p.default is p.empty]
        open_ = [n for n in needed if n not in given and not _takes_many(parameters[n])]
        spoilt = rng.choice(list(parameters), size=1)
        for name in {*open_, *spoilt.tolist()}:
            if not _takes_many(parameters[name]):
                given[name] = odd()[int(rng.integers(len(odd())))]
        with jax.numpy_dtype_promotion("standard"):  # as users have it
            VERBS[verb](**given)

    # The first call of a verb compiles, for half a minute on a slow machine.
    battery.run(attempt, seconds=90, megabytes=1000)


def _takes_many(parameter) -> bool:
    return parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)


NOUNS = {
    name: getattr(jnx, name)
    for name in jnx.__all__
    if inspect.isclass(getattr(jnx, name))
    and name != "Global"
    and not issubclass(getattr(jnx, name), Exception)
    and name not in ("RESULTS", "Solution", "Network", "Report", "Pool", "Selection")
} | {"Dataset.from_arrays": jnx.Dataset.from_arrays}
"""Settings, and what users make by hand; the others verbs make."""


@pytest.mark.parametrize("noun", NOUNS)
def test_a_noun_with_random_fields(noun, battery):
    parameters = inspect.signature(NOUNS[noun]).parameters
    needed = [n for n, p in parameters.items() if p.default is p.empty]
    fitting = {"u": np.zeros((9, 1)), "y": np.zeros((9, 1)), "sample_time": 0.1}
    fitting |= {"inputs": ["a"], "outputs": ["y"], "scheduling": ["a[t]"], "name": "a"}

    def attempt(rng):
        given = {name: fitting[name] for name in needed if name in fitting}
        spoilt = rng.choice(list(parameters), size=1).tolist()
        for name in {*(n for n in needed if n not in fitting), *spoilt}:
            given[name] = odd()[int(rng.integers(len(odd())))]
        NOUNS[noun](**given)

    battery.run(attempt, seconds=20, megabytes=1000)
