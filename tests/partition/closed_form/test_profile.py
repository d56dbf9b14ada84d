"""What the data say: levels, dead times, memory."""

import dataclasses

import nested_problems as problems
import numpy as np
import pytest

from jaxnarx.data import Dataset, check, suggest_lags
from jaxnarx.errors import DataError
from jaxnarx.partition import profile_data
from jaxnarx.partition.closed_form.profile import COUNTED_SAMPLES

DEAD = 3
"""Samples before `a` shows; `b` does so after one."""


def made(change=lambda u: u, rows: int = 300) -> Dataset:
    """First order, 5 samples to 63 %."""
    rng = np.random.default_rng(1)
    us, ys, pole = [], [], np.exp(-1 / 5)
    for _ in range(3):
        a = problems.levels(rng, rows, 15)
        u = np.stack([a, (problems.levels(rng, rows, 20) > 0.5) * 1.0], axis=1)
        y = np.zeros(rows)
        for t in range(DEAD, rows):
            y[t] = pole * y[t - 1] + (1 - pole) * (u[t - DEAD, 0] + u[t - 1, 1])
        us.append(change(u))
        ys.append((y + 0.005 * rng.normal(size=rows))[:, None])
    return problems.dataset(us, ys)


def test_dead_times_rise_and_memory():
    found = profile_data(made(), "y")
    assert found.output == "y" and found.dead_time == (DEAD, 1)
    assert found.rise == pytest.approx(5, abs=1.5)
    assert 10 <= found.memory <= 60 and found.every == 1
    told = found.to_dict(["a", "b"])
    assert told["dead_time"] == {"a": DEAD, "b": 1} and told["few_levels"] == ["b"]


def test_it_agrees_with_check_also_on_long_dead_times():
    rng = np.random.default_rng(0)
    u = np.repeat(rng.normal(size=(60, 2)), 20, axis=0)
    y = np.roll(u[:, 0], 150) + 0.5 * np.roll(u[:, 1], 2)
    y[:150] = y[150]
    data = problems.dataset([u], [(y + 0.01 * rng.normal(size=1200))[:, None]])
    found, lags = profile_data(data, "y"), suggest_lags(data)
    assert found.dead_time == tuple(lags.dead_time[n, "y"] for n in ("a", "b"))
    assert found.dead_time[0] == pytest.approx(150, abs=2)
    (told,) = [f for f in check(data).of("dead time") if f.channel == "a"]
    assert f"after about {found.dead_time[0]} samples" in told.message
    assert "beside the recent ones" in told.message


def test_levels_of_binary_inputs_though_edges_were_resampled():
    def edges(u):
        u = u * [1.0, 3.0] + [0.0, -1.0]
        u[[50, 120], 1] = 0.4
        return u

    assert profile_data(made(edges), "y").levels == (None, (-1.0, 2.0))


def test_three_levels_are_few_and_four_are_not():
    def rounded(count):
        return lambda u: np.stack([np.floor(u[:, 0] * count), u[:, 1]], axis=1)

    assert profile_data(made(rounded(3)), "y").levels[0] == (0.0, 1.0, 2.0)
    assert profile_data(made(rounded(4)), "y").levels[0] is None


def test_a_constant_input_has_one_level_and_no_dead_time():
    found = profile_data(made(lambda u: u * [1.0, 0.0] + [0.0, 7.0]), "y")
    assert found.levels == (None, (7.0,)) and found.dead_time[1] == 0


def test_where_no_answer_is_clear_memory_is_a_share_of_the_records():
    rng = np.random.default_rng(3)
    us = [rng.normal(size=(100, 2)) for _ in range(3)]
    ys = [rng.normal(size=(100, 1)) for _ in range(3)]
    found = profile_data(problems.dataset(us, ys), "y")
    assert found.dead_time == (0, 0) and found.rise == 1.0
    assert 4 <= found.memory <= 25


def test_of_long_data_every_so_many_samples_count():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(size=(4000, 2)), 10, axis=0)
    y = u @ [[1.0], [2.0]] + 0.1 * rng.normal(size=(40_000, 1))
    assert (
        profile_data(problems.dataset([u], [y]), "y").every
        == 40_000 // COUNTED_SAMPLES
        > 1
    )


def test_what_is_measured_nowhere_is_named():
    data = made()
    for place, name in enumerate(data.channels.names):
        seen = np.arange(3) != place
        parts = [dataclasses.replace(r, valid=r.valid & seen[None]) for r in data]
        with pytest.raises(DataError, match=f"{name} is measured nowhere"):
            profile_data(dataclasses.replace(data, records=tuple(parts)), "y")
    nothing = Dataset.from_arrays(
        np.zeros((90, 0)),
        data.records[0].y[:90],
        inputs=[],
        outputs=["y"],
        sample_time=1.0,
    )
    with pytest.raises(DataError, match="no inputs"):
        profile_data(nothing, "y")


def test_one_short_record_does_not_shorten_the_reach():
    data = made()
    short = {k: getattr(data.records[0], k)[:12] for k in ("u", "y", "valid")}
    short = dataclasses.replace(data.records[0], name="short", **short)
    more = dataclasses.replace(data, records=(*data.records, short))
    assert profile_data(more, "y").reach == profile_data(data, "y").reach > 8
