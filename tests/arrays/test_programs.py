"""Programs are compiled quickly where they are small, also within others, and are
forgotten before the process has no room for others."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
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


# small programs ---------------------------------------------------------------------


@pytest.fixture
def asked(monkeypatch):
    """Options with which programs are compiled, one after the other."""
    options, make = [], jax.jit

    def jit(function, *, compiler_options=None):
        options.append(compiler_options)
        return make(function, compiler_options=compiler_options)

    monkeypatch.setattr(programs.jax, "jit", jit)
    return options


def test_small_programs_alone_are_compiled_quickly(asked, made, monkeypatch):
    monkeypatch.setattr(programs, "MOST_QUICK_ENTRIES", 4)
    for size in (4, 5):
        x = np.arange(float(size))
        np.testing.assert_array_equal(made[1](x, 2), 2.0 * x**2)
    assert asked == [programs.QUICK_OPTIONS, None]


def test_a_compiler_that_does_not_know_the_options_is_asked_once(
    asked, made, monkeypatch
):
    unknown = {"xla_cpu_no_such_option": True}
    monkeypatch.setattr(programs, "QUICK_OPTIONS", unknown)
    monkeypatch.setattr(programs, "_knows_options", [True])
    for power, expected in ((2, 18.0), (1, 6.0)):
        assert float(made[1](jnp.asarray(3.0), power)) == expected
    assert asked == [unknown, None, None]


@pytest.mark.parametrize(
    "way",
    [
        lambda f, x: jax.jit(f)(x),
        lambda f, x: jax.jit(lambda: f(x))(),  # no argument is traced
        lambda f, x: jax.vmap(f)(x[None])[0],
        lambda f, x: jax.jvp(f, (x,), (x,))[0],
    ],
    ids=["argument", "constant", "mapped", "derivative"],
)
def test_small_programs_within_others(made, way):
    x = jnp.arange(3.0)
    np.testing.assert_array_equal(way(lambda x: made[1](x, 2), x), [0.0, 2.0, 8.0])


def test_an_error_of_a_small_program_is_told():
    def refuse(x):
        raise ValueError(f"no {x.shape}")

    with pytest.raises(ValueError, match="no"):
        programs.program(refuse)(np.zeros(2))
