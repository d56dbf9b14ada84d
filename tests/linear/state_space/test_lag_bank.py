"""A bank of first-order lags to start from: its dead times, its run, bad records."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from state_plants import made

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.linear import fit_states, state_network
from jaxnarx.linear.state_space.lag_bank import bank_model
from jaxnarx.models import Network
from jaxnarx.settings import HiddenStates
from jaxnarx.simulation import simulate

TIMES = 0.3, 1.5
DEAD = 4, 0, 8


@cache
def runs(square: float = 0.0, rows: int = 1500) -> Dataset:
    """Two records of three inputs, which act after `DEAD` samples through two lags,
    the third also by its square."""
    us, ys = [], []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.uniform(-1, 1, size=(rows // 5 + 1, 3)), 5, axis=0)[:rows]
        columns = zip(DEAD, u.T, strict=True)
        late = [np.concatenate([np.full(d, c[0]), c])[:rows] for d, c in columns]
        drive = (
            late[0] + 0.5 * late[1] - 0.7 * late[2],
            0.4 * late[1] + late[2] + square * late[2] ** 2,
        )
        y = np.full(rows, 2.0)
        for tau, v in zip(TIMES, drive, strict=True):
            p, x = np.exp(-0.1 / tau), v[0]
            for t in range(rows):
                y[t] += x
                x = p * x + (1 - p) * v[t]
        us.append(u)
        ys.append(y[:, None])
    return made(us, ys)


def as_network(data: Dataset) -> Network:
    model, delayed = bank_model(data, 0, TIMES)
    return state_network(model, data, (0,), window=20, delayed=delayed)


def error_of(network: Network, data: Dataset) -> float:
    run = simulate(network, data).value
    pairs = zip(data, run.outputs, run.scored, strict=True)
    error = np.concatenate([(r.y - y)[s] for r, y, s in pairs])
    return float(error.std() / np.concatenate([r.y for r in data]).std())


def test_it_finds_a_plant_of_lags_and_its_dead_times():
    model, delayed = bank_model(runs(), 0, TIMES)
    assert [lag for _, lag in delayed[::2]] == list(DEAD)
    later = delayed[1][1] - delayed[0][1]
    assert delayed[1::2] == tuple((j, lag + later) for j, lag in delayed[::2])
    np.testing.assert_allclose(np.diag(model.a), np.exp(-0.1 / np.array(TIMES)))
    assert error_of(as_network(runs()), runs()) < 0.02


def test_a_dead_time_behind_a_square_is_found():
    """Which is three times what is linear."""
    data = runs(3.0)
    assert bank_model(data, 0, TIMES)[1][4][1] == DEAD[2]


def test_missing_samples_train_nothing():
    data = runs()
    records = []
    for record in data:
        valid, y, u = record.valid.copy(), record.y.copy(), record.u.copy()
        valid[300:330, 3], y[300:330] = False, 1e6
        valid[600:610, 1], u[600:610, 1] = False, np.nan
        records.append(dataclasses.replace(record, valid=valid, y=y, u=u))
    model, delayed = bank_model(
        dataclasses.replace(data, records=tuple(records)), 0, TIMES
    )
    assert [lag for _, lag in delayed[::2]] == list(DEAD)
    assert np.all(np.isfinite(model.b))


def test_gates_are_trained_from_it():
    data = runs(1.0, 500)
    method = HiddenStates(
        outputs=("y",),
        states=2,
        degree=1,
        gates=2,
        times=TIMES,
        shrink=(0.01,),
        window=20,
        max_steps=5,
        first_steps=3,
    )
    found = fit_states(data, method)
    assert found.stats["start"] == "bank of lags"
    assert error_of(found.value, data) < 0.7 * error_of(as_network(data), data)


def test_an_input_that_rests_has_no_part():
    data = runs(rows=400)
    still = [dataclasses.replace(r, u=r.u * [1, 0, 1]) for r in data]
    model, delayed = bank_model(
        dataclasses.replace(data, records=tuple(still)), 0, TIMES
    )
    own = [n for n, (j, _) in enumerate(delayed) if j == 1]
    np.testing.assert_array_equal(model.b[:, own], 0)
    assert delayed[own[0]][1] == 0


def test_records_without_a_sample_that_counts_are_refused():
    data = runs(rows=400)
    blind = [
        dataclasses.replace(r, valid=r.valid & np.array([True, True, True, False]))
        for r in data
    ]
    with pytest.raises(DataError, match="too short for a bank of lags"):
        bank_model(dataclasses.replace(data, records=tuple(blind)), 0, TIMES)


@pytest.mark.parametrize(
    ("times", "told"),
    [
        ((1.0,), "one for each of the 2 states"),
        ((1.0, -1.0), "must be positive"),
        ((1.0, np.inf), "finite"),
    ],
)
def test_time_constants_that_make_no_sense_are_refused(times, told):
    with pytest.raises(SpecError, match=told):
        HiddenStates(states=2, times=times)
