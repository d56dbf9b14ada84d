"""Programs are forgotten before the process has no room for others."""

import itertools

import jax.numpy as jnp
import pytest

from jaxnarx.arrays import programs


@pytest.fixture
def system(tmp_path, monkeypatch):
    """Files of a system that allows ten memory maps and looks at every program."""
    maps, most = tmp_path / "maps", tmp_path / "max_map_count"
    maps.write_text("one\n")
    most.write_text("10\n")
    monkeypatch.setattr(programs, "MEMORY_MAP_FILES", maps)
    monkeypatch.setattr(programs, "MOST_MAPS", most)
    monkeypatch.setattr(programs, "PROGRAMS_BETWEEN_CHECKS", 1)
    return maps


@pytest.fixture
def made():
    """How often a function was traced, and the program of it."""
    traces = itertools.count()

    def twice(x, power):
        next(traces)
        return 2.0 * x**power

    return traces, programs.program(twice)


def test_programs_are_kept_while_there_is_room(system, made):
    traces, twice = made
    assert [float(twice(jnp.asarray(3.0), power)) for power in (1, 2, 1)] == [6, 18, 6]
    assert next(traces) == 2


def test_programs_are_forgotten_and_made_again(system, made):
    traces, twice = made
    assert float(twice(jnp.asarray(3.0), 1)) == 6.0
    system.write_text("one\n" * 7)  # above six of ten
    assert float(twice(jnp.asarray(3.0), 2)) == 18.0
    system.write_text("one\n")
    assert float(twice(jnp.asarray(3.0), 1)) == 6.0
    assert next(traces) == 3


def test_a_system_that_does_not_tell_is_never_crowded(system):
    system.write_text("one\n" * 11)
    assert programs.is_crowded()
    system.unlink()
    assert not programs.is_crowded()
