"""What every bed does alike: interface, domain, noise, flags, relatives, records."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxnarx.contracts import engine
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
from jaxnarx.errors import SpecError
from jaxnarx.excitation import aprbs

# A program for every bed.
pytestmark = pytest.mark.slow

LENGTH = engine.RUN_SAMPLES


@pytest.fixture(scope="module", params=list(BEDS))
def bed(request):
    return BEDS[request.param]()


@pytest.fixture(scope="module")
def excited(bed):
    """Two usual records of a bed, without noise."""
    return engine.usual(bed)


@pytest.mark.parametrize("check", engine.CHECKS, ids=lambda check: check.__name__)
def test_a_bed_holds_to_its_contract(bed, excited, check):
    check(bed, excited)


# One bed is enough for what is implemented once.


def test_dotted_names_reach_the_parts():
    bed = PfiDyno()
    moved = bed.perturb(jax.random.key(3), 0.1)
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
    data = records(
        *(Pfi(), key, (LENGTH, LENGTH)),
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
