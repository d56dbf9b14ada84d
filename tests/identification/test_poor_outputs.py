"""Whole searches of outputs that hold little: rare peaks, few or uneven groups."""

import dataclasses

import numpy as np
import pytest
from search_problems import LENGTHS, made, steps

import jaxnarx as jnx
from jaxnarx.data import Dataset, Groups
from jaxnarx.settings import PRESETS, Preset

TINY = Preset("for tests", max_models=2, grown=1, fed_back=0, states=0, roots=1, sums=3)


def peaks(lowest: float) -> Dataset:
    """Nothing but ten peaks in all records, upon `lowest`."""
    rng = np.random.default_rng(6)
    us = [steps(rng, n, 7) for n in LENGTHS]
    ys = [np.full((n, 1), lowest) for n in LENGTHS]
    for k in range(10):
        ys[k % 4][20 + 11 * k] += 5.0 + k
    return made([u[:, None] for u in us], ys)


def uneven() -> Dataset:
    """A long record and three short ones."""
    rng = np.random.default_rng(7)
    us, ys = [], []
    for n in (400, 60, 40, 40):
        u, y = steps(rng, n, 7), np.zeros(n)
        for t in range(1, n):
            y[t] = 0.7 * y[t - 1] + u[t - 1] ** 2
        us.append(u[:, None])
        ys.append(y[:, None] + 0.01 * rng.normal(size=(n, 1)))
    return made(us, ys)


@pytest.mark.parametrize("lowest", [0.0, -7.0])
def test_rare_peaks_are_searched_with_their_root(monkeypatch, lowest):
    monkeypatch.setitem(PRESETS, "tiny", TINY)
    data = peaks(lowest)
    found = jnx.identify(data, preset="tiny")
    board = found.stats["leaderboard"]
    assert any("root" in row.family for row in board)
    assert all(row.free_run is None or row.free_run < 2 for row in board)
    run = jnx.simulate(found.value, data).value
    assert not any(lost.any() for lost in run.diverged)
    assert all(np.isfinite(y).all() for y in run.outputs)


def test_groups_of_very_different_length_are_all_judged(monkeypatch):
    monkeypatch.setitem(PRESETS, "tiny", dataclasses.replace(TINY, roots=0))
    data = uneven()
    labels = tuple(np.full(len(r), n) for n, r in enumerate(data))
    found = jnx.identify(
        data, preset="tiny", groups=Groups(tuple(data.names), labels, True)
    )
    row = found.stats["leaderboard"].choose("y")
    assert row is not None and row.nested is not None
    assert all(e is not None and e < 0.5 for e in row.nested_groups)
