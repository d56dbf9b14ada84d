"""Measurements of a small engine for the tests of preparation, and how to compare."""

import numpy as np
import pytest

from jaxnarx.data import Dataset


def engine(*rows: int, gaps: bool = True, seed: int = 3) -> Dataset:
    """Speed [rpm] in slow waves and a NOx [ppm] that follows, with gaps and spikes."""
    rng = np.random.default_rng(seed)
    us, ys = [], []
    for n in rows:
        t = 0.1 * np.arange(n)
        speed = 1500 + 400 * np.sin(t) + 20 * rng.standard_normal(n)
        nox = 80 + 0.03 * speed + 5 * np.cos(0.7 * t) + rng.standard_normal(n) + 0.2 * t
        if gaps:
            nox[[17, 31]] += 400
            nox[50:54] = np.nan
            speed[[0, 1, 70]] = np.nan
        us.append(speed[:, None])
        ys.append(nox[:, None])
    return Dataset.from_arrays(
        us,
        ys,
        inputs=["speed"],
        outputs=["NOx"],
        sample_time=0.1,
        units={"speed": "rpm", "NOx": "ppm"},
        names=[f"r{i}" for i in range(len(rows))],
        missing="mask",
    )


def columns(record) -> np.ndarray:
    return np.concatenate([record.u, record.y], axis=1)


def pooled(data: Dataset, j: int) -> np.ndarray:
    """Valid samples of a signal over all records."""
    return np.concatenate([columns(r)[r.valid[:, j], j] for r in data])


def same(a: Dataset, b: Dataset, *, rtol: float = 0.0, atol: float = 0.0):
    assert (a.channels, a.names) == (b.channels, b.names)
    assert a.sample_time == pytest.approx(b.sample_time, rel=1e-12)
    for r, s in zip(a, b, strict=True):
        np.testing.assert_array_equal(r.valid, s.valid)
        np.testing.assert_allclose(columns(r), columns(s), rtol=rtol, atol=atol)


def levels(x) -> Dataset:
    return Dataset.from_arrays(
        None, np.asarray(x), inputs=[], outputs=["y"], sample_time=1
    )
