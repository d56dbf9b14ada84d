"""The contract of a virtual engine, `BEDS.register(name, Kind)`.

A check is given the engine and two of its usual records without noise, `usual(engine)`.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.data import Dataset
from jaxnarx.engines import AbstractEngine, Noise, family, family_run, records
from jaxnarx.errors import DataError, SpecError

RUN_SAMPLES = 60


def usual(engine: AbstractEngine) -> Dataset:
    """Two records under its usual excitation, without noise."""
    return records(engine, jax.random.key(5), (RUN_SAMPLES, RUN_SAMPLES), noise=0)


def names_agree(bed: AbstractEngine, excited: Dataset) -> None:
    """Ranges, domain and noise are those of the channels, ranges inside of the
    domain."""
    inputs, outputs = bed.channels.input_names, bed.channels.output_names
    assert list(bed.ranges) == list(bed.domain) == inputs
    assert list(bed.noise) == outputs and set(bed.limits) <= set(outputs)
    assert all(isinstance(size, Noise) for size in bed.noise.values())
    for name, (low, high) in bed.ranges.items():
        least, most = bed.domain[name]
        assert least <= low < high <= most, name


def excitation_is_inside_the_domain_and_repeats(
    bed: AbstractEngine, excited: Dataset
) -> None:
    """The usual excitation obeys the domain; one key gives one signal, another key
    another."""
    first, second = excited.records
    assert first.u.shape == (RUN_SAMPLES, len(bed.channels.inputs))
    for j, (low, high) in enumerate(bed.domain.values()):
        assert low <= first.u[:, j].min() and first.u[:, j].max() <= high
    assert not np.array_equal(first.u, second.u)
    excite_key = jax.random.split(jax.random.key(5))[0]
    again = bed.excite(jax.random.fold_in(excite_key, 0), RUN_SAMPLES)
    np.testing.assert_array_equal(first.u, again)


def a_record_starts_at_its_steady_outputs(
    bed: AbstractEngine, excited: Dataset
) -> None:
    """A run begins at rest under its first inputs."""
    row = jnp.asarray(excited.records[0].u[0])
    outputs = eqx.filter_jit(lambda b, u: b.steady_outputs(u))(bed, row)
    np.testing.assert_allclose(excited.records[0].y[0], outputs, rtol=1e-9, atol=1e-12)


def flags_cover_every_event(bed: AbstractEngine, excited: Dataset) -> None:
    """Every limit has a flag for every event; at rest, usually, none is broken."""
    u = excited.records[0].u
    flags = bed.flags(u)
    assert flags and all(
        broken.shape == (RUN_SAMPLES,) and broken.dtype == bool
        for broken in flags.values()
    )
    # A bed at rest in the middle of its usual range breaks nothing.
    assert not any(broken[0] for broken in flags.values())


def a_broken_bed_breaks_limits_and_is_refused(
    bed: AbstractEngine, excited: Dataset
) -> None:
    """Values that are not finite break limits, and no record is made of them."""
    dead = jax.tree.map(lambda leaf: leaf * jnp.nan, bed)
    assert any(f.all() for f in dead.flags(excited.records[0].u).values())
    inputs, names = [r.u for r in excited], ["dead", "too"]
    with pytest.raises(DataError, match="'dead': .* is nan.* event 0, .*where .* is"):
        dead.simulate(inputs, jax.random.key(0), names=names)


def inputs_of_another_number_are_refused(bed: AbstractEngine, excited: Dataset) -> None:
    """With the names of those that there are."""
    wrong = np.full((5, len(bed.ranges) + 1), 10.0)
    with pytest.raises(SpecError, match=", ".join(bed.ranges)):
        bed.simulate(wrong, jax.random.key(0))


def inputs_outside_the_domain_are_refused(
    bed: AbstractEngine, excited: Dataset
) -> None:
    """With record, event and input."""
    for j, (name, (low, high)) in enumerate(bed.domain.items()):
        for value in (low - 0.01 * (high - low), high + 0.01 * (high - low)):
            u = excited.records[0].u.copy()
            u[7, j] = value
            with pytest.raises(DataError, match=f"'record 2': input {name} is") as e:
                bed.simulate([excited.records[1].u, u], jax.random.key(0))
            assert e.value.channel == name and e.value.row == 7


def relatives_differ_and_run(bed: AbstractEngine, excited: Dataset) -> None:
    """Stacked engines run as each alone; a spread of zero moves nothing."""
    u = jnp.asarray(excited.records[0].u)
    engines: Any = family(bed, jax.random.key(1), 3, spread=0.02)
    found = family_run(engines, u, chunk=2)
    assert found.shape == (3, RUN_SAMPLES, len(bed.channels.outputs))
    assert np.isfinite(found).all()
    assert np.ptp(found[:, -1, 0]) > 0
    one = jax.tree.map(lambda leaf: leaf[2], engines)
    expected = eqx.filter_jit(lambda b, u: b.run(u))(one, u)
    # Vectorised sums round differently, and hard limits pass that on.
    np.testing.assert_allclose(found[2], expected, rtol=1e-7, atol=1e-9)
    same = family(bed, jax.random.key(1), 2, spread=0.0)
    for leaf, old in zip(jax.tree.leaves(same), jax.tree.leaves(bed), strict=True):
        np.testing.assert_array_equal(leaf, jnp.stack([old, old]))


def every_varied_parameter_is_moved_alone(
    bed: AbstractEngine, excited: Dataset
) -> None:
    """`perturb` moves those that `varied` names and no other."""
    moved = bed.perturb(jax.random.key(2), 0.1)
    pairs = zip(jax.tree.leaves(bed), jax.tree.leaves(moved), strict=True)
    assert sum(bool(a != b) for a, b in pairs) == len(bed.varied)


CHECKS = (
    names_agree,
    excitation_is_inside_the_domain_and_repeats,
    a_record_starts_at_its_steady_outputs,
    flags_cover_every_event,
    a_broken_bed_breaks_limits_and_is_refused,
    inputs_of_another_number_are_refused,
    inputs_outside_the_domain_are_refused,
    relatives_differ_and_run,
    every_varied_parameter_is_moved_alone,
)
