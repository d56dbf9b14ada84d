"""What every bed does alike: interface, domain, noise, flags, relatives, records."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.engines import (
    BEDS,
    Noise,
    Pfi,
    PfiDyno,
    family,
    family_run,
    pfi_siso_records,
    records,
)
from jaxnarx.errors import DataError, SpecError
from jaxnarx.excitation import aprbs

# A program for every bed.
pytestmark = pytest.mark.slow

LENGTH = 60


@pytest.fixture(scope="module", params=list(BEDS))
def bed(request):
    return BEDS[request.param]()


@pytest.fixture(scope="module")
def excited(bed):
    """Two usual records of a bed, without noise."""
    return records(bed, jax.random.key(5), (LENGTH, LENGTH), noise=0)


def test_names_agree(bed):
    inputs, outputs = bed.channels.input_names, bed.channels.output_names
    assert list(bed.ranges) == list(bed.domain) == inputs
    assert list(bed.noise) == outputs and set(bed.limits) <= set(outputs)
    assert all(isinstance(size, Noise) for size in bed.noise.values())
    for name, (low, high) in bed.ranges.items():
        least, most = bed.domain[name]
        assert least <= low < high <= most, name


def test_excitation_is_inside_the_domain_and_repeats(bed, excited):
    first, second = excited.records
    assert first.u.shape == (LENGTH, len(bed.channels.inputs))
    for j, (low, high) in enumerate(bed.domain.values()):
        assert low <= first.u[:, j].min() and first.u[:, j].max() <= high
    assert not np.array_equal(first.u, second.u)
    excite_key = jax.random.split(jax.random.key(5))[0]
    again = bed.excite(jax.random.fold_in(excite_key, 0), LENGTH)
    np.testing.assert_array_equal(first.u, again)


def test_a_record_starts_at_its_steady_outputs(bed, excited):
    row = jnp.asarray(excited.records[0].u[0])
    outputs = eqx.filter_jit(lambda b, u: b.steady_outputs(u))(bed, row)
    np.testing.assert_allclose(excited.records[0].y[0], outputs, rtol=1e-9, atol=1e-12)


def test_flags_cover_every_event(bed, excited):
    u = excited.records[0].u
    flags = bed.flags(u)
    assert flags and all(
        broken.shape == (LENGTH,) and broken.dtype == bool for broken in flags.values()
    )
    # A bed at rest in the middle of its usual range breaks nothing.
    assert not any(broken[0] for broken in flags.values())


def test_a_broken_bed_breaks_limits_and_is_refused(bed, excited):
    dead = jax.tree.map(lambda leaf: leaf * jnp.nan, bed)
    assert any(f.all() for f in dead.flags(excited.records[0].u).values())
    inputs, names = [r.u for r in excited], ["dead", "too"]
    with pytest.raises(DataError, match="'dead': .* is nan.* event 0, .*where .* is"):
        dead.simulate(inputs, jax.random.key(0), names=names)


def test_inputs_of_another_number_are_refused(bed):
    wrong = np.full((5, len(bed.ranges) + 1), 10.0)
    with pytest.raises(SpecError, match=", ".join(bed.ranges)):
        bed.simulate(wrong, jax.random.key(0))


def test_inputs_outside_the_domain_are_refused(bed, excited):
    for j, (name, (low, high)) in enumerate(bed.domain.items()):
        for value in (low - 0.01 * (high - low), high + 0.01 * (high - low)):
            u = excited.records[0].u.copy()
            u[7, j] = value
            with pytest.raises(DataError, match=f"'record 2': input {name} is") as e:
                bed.simulate([excited.records[1].u, u], jax.random.key(0))
            assert e.value.channel == name and e.value.row == 7


def test_relatives_differ_and_run(bed, excited):
    u = jnp.asarray(excited.records[0].u)
    engines = family(bed, jax.random.key(1), 3, spread=0.02)
    found = family_run(engines, u, chunk=2)
    assert found.shape == (3, LENGTH, len(bed.channels.outputs))
    assert np.isfinite(found).all()
    assert np.ptp(found[:, -1, 0]) > 0
    one = jax.tree.map(lambda leaf: leaf[2], engines)
    expected = eqx.filter_jit(lambda b, u: b.run(u))(one, u)
    # Vectorised sums round differently, and hard limits pass that on.
    np.testing.assert_allclose(found[2], expected, rtol=1e-7, atol=1e-9)
    same = family(bed, jax.random.key(1), 2, spread=0.0)
    for leaf, old in zip(jax.tree.leaves(same), jax.tree.leaves(bed), strict=True):
        np.testing.assert_array_equal(leaf, jnp.stack([old, old]))


def test_every_varied_parameter_is_moved_alone(bed):
    moved = bed.perturbed(jax.random.key(2), 0.1)
    pairs = zip(jax.tree.leaves(bed), jax.tree.leaves(moved), strict=True)
    assert sum(bool(a != b) for a, b in pairs) == len(bed.varied)


# One bed is enough for what is implemented once.


def test_dotted_names_reach_the_parts():
    bed = PfiDyno()
    moved = bed.perturbed(jax.random.key(3), 0.1)
    assert moved.engine.displacement != bed.engine.displacement
    assert moved.engine.inertia == bed.engine.inertia


def test_relative_noise_follows_the_reading(monkeypatch, key):
    sizes = {"speed": Noise(2.0, 0.01), "MAP": Noise(0.0, 0.02)}
    monkeypatch.setattr(Pfi, "noise", property(lambda self: sizes))
    # A new array type makes a new program, which sees the new sizes.
    still = np.full(4096, 0.395)
    loud, quiet = (Pfi().simulate(still, key, noise=n).records[0].y for n in (1.0, 0))
    expected = [2.0 + 0.01 * quiet[0, 0], 0.02 * quiet[0, 1]]
    # Four standard errors of a standard deviation.
    found = np.std(loud - quiet, axis=0)
    np.testing.assert_allclose(found, expected, rtol=4 / np.sqrt(2 * 4096))


def test_records_take_another_excitation(key):
    engine = Pfi()
    data = records(
        *(engine, key, (LENGTH, LENGTH)),
        names=["a", "b"],
        outputs=["MAP"],
        noise=0,
        excite=lambda key, length: aprbs(
            key, length, hold=(5, 9), amplitude=(0.39, 0.4)
        )[:, None],
    )
    assert data.names == ["a", "b"] and data.channels.output_names == ["MAP"]
    assert 0.39 <= data.records[0].u.min() and data.records[0].u.max() <= 0.4


def test_pfi_siso_records_are_the_usual_ones(key):
    kept = pfi_siso_records(key, (LENGTH, LENGTH), names=None, outputs=None)
    usual = records(Pfi(), key, (LENGTH, LENGTH))
    for one, other in zip(kept, usual, strict=True):
        np.testing.assert_array_equal(one.u, other.u)
        np.testing.assert_array_equal(one.y, other.y)


@pytest.mark.parametrize("options", [{"chunk": 0}, {"workers": 0}])
def test_wrong_family_options_are_refused(options):
    engines = family(Pfi(), jax.random.key(0), 2)
    with pytest.raises(SpecError, match="at least 1"):
        family_run(engines, jnp.full((3, 1), 0.4), **options)
    with pytest.raises(SpecError, match="count"):
        family(Pfi(), jax.random.key(0), 0)
