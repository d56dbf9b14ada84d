"""Welch's spectra against scipy, their confidence, and the check of nonlinearity."""

import numpy as np
import pytest
import scipy.signal

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear import nonlinearity, spectra

T, SEGMENT = 0.1, 256
B, A = [0, 1, 0.5], [1, -1.2, 0.5]


def excitation(seed: int, samples: int) -> np.ndarray:
    levels = np.random.default_rng(seed).uniform(-1, 1, -(-samples // 3))
    return np.repeat(levels, 3)[:samples]


def dataset(us, ys, inputs=("u",), missing="refuse") -> Dataset:
    return Dataset.from_arrays(
        us, ys, inputs=inputs, outputs=["y"], sample_time=T, missing=missing
    )


def noisy(seed: int, samples: int, noise: float, curve: float = 0.0):
    u = excitation(seed, samples)
    w = np.asarray(scipy.signal.lfilter(B, A, u))
    e = np.random.default_rng(1000 + seed).normal(size=samples)
    return u, w + curve * w**2 + noise * e


def exact(frequency):
    back = np.exp(-2j * np.pi * frequency * T)
    return np.polyval(B[::-1], back) / np.polyval(A[::-1], back)


def test_one_record_is_scipys_estimate():
    u, y = noisy(0, 3000, 0.3)
    found = spectra(dataset(u, y), segment=SEGMENT)
    settings = {"fs": 1 / T, "window": "hann", "nperseg": SEGMENT}
    inner = slice(1, -1)
    frequency, expected = scipy.signal.coherence(u, y, **settings)
    np.testing.assert_allclose(found.frequency, frequency[inner])
    np.testing.assert_allclose(found.coherence, expected[inner], rtol=1e-9)
    _, cross = scipy.signal.csd(u, y, **settings)
    _, own = scipy.signal.welch(u, **settings)
    np.testing.assert_allclose(found.response[:, 0], (cross / own)[inner], rtol=1e-9)
    _, power = scipy.signal.welch(y, **settings)
    np.testing.assert_allclose(found.output_spectrum, power[inner], rtol=1e-9)


def test_records_are_averaged_but_never_joined():
    pairs = [noisy(seed, 1200, 0.3) for seed in range(3)]
    us, ys = map(list, zip(*pairs, strict=True))
    together = spectra(dataset(us, ys), segment=SEGMENT)
    alone = [spectra(dataset(u, y), segment=SEGMENT) for u, y in pairs]
    mean = np.mean([a.output_spectrum for a in alone], axis=0)
    np.testing.assert_allclose(together.output_spectrum, mean)
    assert together.segments == sum(a.segments for a in alone)
    backwards = spectra(dataset(us[::-1], ys[::-1]), segment=SEGMENT)
    np.testing.assert_allclose(together.coherence, backwards.coherence)


def test_segments_with_missing_samples_are_left_out():
    u, y = noisy(1, 2000, 0.3)
    # The gap spoils the segments that hold sample 900, and no others.
    broken = y.copy()
    broken[900] = np.nan
    whole = spectra(dataset(u, y), segment=SEGMENT)
    gap = spectra(dataset(u, broken, missing="mask"), segment=SEGMENT)
    starts = np.arange(0, 2000 - SEGMENT + 1, SEGMENT // 2)
    hit = (starts <= 900) & (900 < starts + SEGMENT)
    assert gap.segments == whole.segments - hit.sum()
    assert np.all(np.isfinite(gap.response))


def test_a_static_gain_is_exact():
    u = excitation(2, 1500)
    found = spectra(dataset(u, 3 * u + 7), segment=SEGMENT)
    np.testing.assert_allclose(found.response, 3.0, rtol=1e-9)
    np.testing.assert_allclose(found.coherence, 1.0)
    assert found.deviation.max() < 1e-6


def test_deviations_are_those_of_repetition():
    """Errors of the response over 40 noises, in claimed standard deviations."""
    scores = []
    for seed in range(40):
        u, _ = noisy(7, 3000, 0.0)
        e = np.random.default_rng(seed).normal(size=3000)
        y = scipy.signal.lfilter(B, A, u) + 0.5 * e
        found = spectra(dataset(u, y), segment=SEGMENT)
        quiet = spectra(dataset(u, y - 0.5 * e), segment=SEGMENT)
        # Against the noise-free estimate: leakage is not the point here.
        error = np.abs(found.response) - np.abs(quiet.response)
        scores.append((error / found.deviation)[:60])
    # Some 23 segments: the claimed deviation itself scatters by 15 %.
    assert np.std(scores) == pytest.approx(1.0, abs=0.12)


def test_unrelated_signals_stay_below_the_level_of_chance():
    share = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        found = spectra(dataset(*rng.normal(size=(2, 3000))), segment=SEGMENT)
        share.append(np.mean(found.coherence > found.chance))
    # 30 x 127 frequencies, neighbours dependent: 0.05 is known to 0.006.
    assert np.mean(share) == pytest.approx(0.05, abs=0.02)


def test_the_response_of_a_filter_is_found():
    u, y = noisy(3, 40_000, 0.1)
    found = spectra(dataset(u, y), segment=1024)
    truth = exact(found.frequency)
    strong = np.abs(truth) > 1
    np.testing.assert_allclose(
        found.response[strong, 0], truth[strong], rtol=0.05, atol=0.05
    )


def test_several_inputs_share_the_explanation():
    rng = np.random.default_rng(0)
    u = rng.normal(size=(3000, 2))
    data = dataset(u, u @ [2.0, -1.0], inputs=("a", "b"))
    found = spectra(data, segment=SEGMENT)
    np.testing.assert_allclose(found.coherence, 1.0)
    np.testing.assert_allclose(found.response, [[2.0, -1.0]] * 127, atol=1e-9)
    # One alone explains its part: 4 of 5.
    alone = spectra(data, inputs=["a"], segment=SEGMENT)
    assert alone.coherence.mean() == pytest.approx(0.8, abs=0.05)


def test_inputs_that_move_together_have_no_finite_deviation():
    u = excitation(4, 2000)
    data = dataset(np.stack([u, 2 * u], axis=1), u, inputs=("a", "b"))
    found = spectra(data, segment=SEGMENT)
    np.testing.assert_allclose(found.response @ [1.0, 2.0], 1.0)
    assert np.all(np.isinf(found.deviation))


def ways(curve: float, noise: float = 0.2):
    """The check against a number, against still records, and by repetition."""
    u, clean = noisy(5, 12_000, 0.0, curve)
    e = noise * np.random.default_rng(0).normal(size=(5, len(u)))
    one = dataset(u, clean + e[0])
    still = dataset(0 * u, e[4])
    repeats = dataset([u] * 4, list(clean + e[:4]))
    yield nonlinearity(one, noise=noise, segment=SEGMENT)
    yield nonlinearity(one, noise=still, segment=SEGMENT)
    yield nonlinearity(repeats, noise="repeats", segment=SEGMENT)


def test_a_linear_system_with_noise_passes():
    for found in ways(0.0):
        assert not found.nonlinear and found.share == 0
        assert "nothing beyond" in str(found)


def test_a_bent_system_does_not():
    for found in ways(0.2):
        assert found.nonlinear and found.share > 0.05
        low = found.coherence[found.exceeds]
        assert np.all(low < found.expected_coherence[found.exceeds])
        assert "neither a linear response" in str(found)


def test_coherence_alone_cannot_tell():
    """The same coherence from noise and from a curve; the checks tell them apart."""
    bent = next(ways(0.1))
    u, clean = noisy(5, 12_000, 0.0)
    noise = np.sqrt(bent.share) * clean.std() + 0.2
    white = np.random.default_rng(1).normal(size=len(u))
    data = dataset(u, clean + noise * white)
    plain = nonlinearity(data, noise=noise, segment=SEGMENT)
    band = slice(0, 20)
    assert plain.coherence[band].mean() < bent.coherence[band].mean() + 0.05
    assert bent.nonlinear and not plain.nonlinear


def test_wrong_requests_are_refused():
    u, y = noisy(0, 600, 0.1)
    data = dataset(u, y)
    with pytest.raises(SpecError, match="unknown input"):
        spectra(data, inputs=["v"])
    with pytest.raises(SpecError, match="overlap"):
        spectra(data, overlap=1.0)
    with pytest.raises(DataError, match="valid samples"):
        spectra(data, segment=1000)
    with pytest.raises(DataError, match="too few"):
        spectra(data, segment=500)
    with pytest.raises(DataError, match="two records"):
        nonlinearity(data, noise="repeats")
    with pytest.raises(DataError, match="equal inputs"):
        nonlinearity(dataset([u, 2 * u], [y, y]), noise="repeats")
    with pytest.raises(SpecError, match="noise"):
        nonlinearity(data, noise=-1.0)
