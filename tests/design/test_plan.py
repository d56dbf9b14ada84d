"""The next test of a network: limits kept, information, files and the command."""

import jax
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.data import Dataset
from jaxnarx.design._plan import HOLD_MEMORIES, REFUSED_SHARE
from jaxnarx.design.limits import limits_for
from jaxnarx.design.stretches import Space, stretches
from jaxnarx.design.views import information_gain
from jaxnarx.errors import SpecError
from jaxnarx.models import input_memory
from jaxnarx.shell.cli import run

DURATION, TIME = 60.0, 0.5
RANGES = {"speed": (-3.0, 4.0), "load": (-2.0, 2.0)}
RATES = {"speed": 1.0}
FORBIDDEN = "speed > 1 & load < 0"


def plant(seed: int) -> Dataset:
    """A slow output of two inputs and a switch."""
    rng, length = np.random.default_rng(seed), 300
    u, y = [], []
    for _ in range(3):
        each = [
            np.repeat(rng.uniform(-1, 1, 40), rng.integers(4, 20, 40)) for _ in "ab"
        ]
        switch = np.repeat(rng.integers(0, 2, 40), rng.integers(8, 20, 40))
        one = np.stack([np.resize(a, length) for a in (*each, switch)], axis=1)
        out = np.zeros((length, 1))
        for t in range(1, length):
            a, b, c = one[t - 1]
            out[t] = 0.8 * out[t - 1] + 0.2 * (a + b + 0.5 * a * b + 0.5 * c)
        u.append(one)
        y.append(out + 0.01 * rng.normal(size=out.shape))
    return Dataset.from_arrays(
        u,
        y,
        inputs=["speed", "load", "switch"],
        outputs=["temp"],
        sample_time=TIME,
        units={"speed": "rpm", "load": "%", "switch": "-", "temp": "K"},
    )


@pytest.fixture(scope="module")
def known():
    """A network that knows its domain and its errors."""
    data = plant(0)
    pool = jnx.polynomial_pool(data.channels, input_lags=[1], output_lags=[1], degree=2)
    chosen = jnx.select(pool, data, jnx.ForwardOLS(max_terms=6)).value
    network = jnx.grow(chosen, data, jnx.Global()).value
    return jnx.confidence.fit_error_model(
        jnx.confidence.fit_domain(network, data), plant(1)
    )


def made(network, **options):
    asked = {"ranges": RANGES, "rates": RATES, "forbidden": [FORBIDDEN]}
    asked |= {"limits": {"temp": 2.0}, "seed": 1, **options}
    return jnx.design.plan(network, duration=DURATION, **asked)


@pytest.fixture(scope="module")
def found(known):
    return made(known)


def test_no_limit_is_broken(known, found):
    u, value = found.value.inputs, found.value
    assert len(u) == DURATION / TIME and found.status_name == "ok"
    low, high = np.array([*RANGES.values(), (0, 1)]).T
    assert np.all((u >= low) & (u <= high))
    # Differences of numbers of size 4, rounded: a few units in the last place.
    assert np.abs(np.diff(u[:, 0])).max() <= RATES["speed"] * TIME + 1e-14
    assert not np.any((u[:, 0] > 1) & (u[:, 1] < 0))
    assert set(np.unique(u[:, 2])) == {0.0, 1.0}
    assert np.all(value.outputs[:, 0] + value.margin[:, 0] < 2.0)
    assert np.all(value.margin > 0) and found.stats["room"]["temp"] > 0
    # and it is the network's own free run
    run = jnx.simulate(known, value.data).value.outputs[0]
    np.testing.assert_allclose(run[20:], value.outputs[20:], atol=1e-3)
    # It is worth having: most of it where the network has never been.
    assert found.stats["outside"] > 0.5 and found.stats["still"] < 0.2


def test_how_much_limits_of_outputs_refuse_is_told(known, found):
    tight = made(known, limits={"temp": (-0.25, 0.3)})
    assert 0 < found.stats["refused"] < REFUSED_SHARE < tight.stats["refused"]
    assert "limits of outputs refuse" in tight.detail
    assert "refuse" not in found.detail


def test_it_begins_in_known_territory_and_goes_beyond(known, found):
    index = jnx.domain(known, found.value.data).value.index[0]
    np.testing.assert_allclose(index[20:], found.value.index[20:], rtol=1e-6)
    assert found.value.index[0] < 1 < found.value.index.max()
    start = found.stats["start"]
    assert start[0] == 0 and np.all(np.diff(start) > 0)


def test_a_seed_gives_the_same_plan_again(known, found):
    np.testing.assert_array_equal(made(known).value.inputs, found.value.inputs)
    assert np.any(made(known, seed=2).value.inputs != found.value.inputs)


def test_it_tells_more_than_random_stretches(known, found):
    """By its own account, and by the plain determinant of the squares of the inputs
    against stretches drawn at random in the same space."""
    assert found.stats["information"] > found.stats["random"]
    assert np.isclose(found.stats["information"], found.stats["gain"].sum())
    free = made(known, forbidden=[], limits=None)
    assert free.stats["refused"] == 0
    space = Space(
        np.array([-3.0, -2.0, 0.0]),
        np.array([4.0, 2.0, 1.0]),
        np.array([RATES["speed"] * TIME, np.inf, np.inf]),
        np.array([False, False, True]),
    )
    length = round(DURATION / TIME)
    rng = np.random.default_rng(2)
    shortest, longest = (max(1, round(h * input_memory(known))) for h in HOLD_MEMORIES)
    hold = shortest, longest
    drawn = stretches(rng, space, free.value.inputs[0], 41, length, hold)
    worth = np.array([log_det(u) for u in drawn[1:]])
    assert log_det(free.value.inputs) > np.quantile(worth, 0.75)


def log_det(u: np.ndarray) -> float:
    """Of the information about a quadratic of the inputs, as large as their ranges."""
    x = np.stack([(u[:, 0] - 0.5) / 3.5, u[:, 1] / 2, 2 * u[:, 2] - 1], axis=1)
    terms = [
        np.ones(len(x)),
        *x.T,
        *(x[:, i] * x[:, j] for i in (0, 1) for j in (0, 1, 2) if j >= i),
    ]
    rows = np.stack(terms, axis=1)
    return float(np.linalg.slogdet(rows.T @ rows + 1e-6 * np.eye(rows.shape[1]))[1])


def test_what_rows_tell_is_the_determinant_they_add():
    rng = np.random.default_rng(3)
    rows, m = rng.normal(size=(7, 5)), np.eye(5)
    for _ in range(2):
        expected = np.linalg.slogdet(m + rows.T @ rows)[1] - np.linalg.slogdet(m)[1]
        assert np.isclose(
            information_gain(*jax.device_put((np.linalg.cholesky(m), rows))),
            expected,
            rtol=1e-12,
        )
        m = m + rows.T @ rows


def test_stretches_go_on_from_where_the_test_is():
    rng = np.random.default_rng(4)
    low, high, rate = (
        np.array([-1.0, 0.0]),
        np.array([3.0, 1.0]),
        np.array([0.25, np.inf]),
    )
    space = Space(low, high, rate, np.array([False, True]))
    begin = np.array([2.0, 1.0])
    u = stretches(rng, space, begin, 20, 40, (5, 40), near=5)
    assert u.shape == (20, 40, 2) and np.all(u[0] == begin)
    step = np.abs(np.diff(np.concatenate([np.tile(begin, (20, 1, 1)), u], 1), axis=1))
    assert np.all(step[..., 0] <= 0.25 + 1e-14)
    assert np.all((u >= low) & (u <= high)) and set(np.unique(u[..., 1])) == {0.0, 1.0}


def test_of_every_second_test_all_inputs_switch_together_to_what_is_allowed():
    low, high = np.zeros(2), np.ones(2)
    free, never = np.full(2, np.inf), np.zeros(2, bool)

    def apart(u):
        return np.abs(u[..., 0] - u[..., 1]) < 0.2

    space = Space(low, high, free, never, apart)
    rng = np.random.default_rng(0)
    assert np.all(apart(space.points(rng, 500)))
    u = stretches(rng, space, np.array([0.5, 0.5]), 20, 60, (5, 40))
    moves = np.diff(u, axis=1) != 0
    together = np.all(moves[..., 0] == moves[..., 1], axis=1)
    assert together[::2].all() and not together[1::2].any()
    assert np.all(apart(u[::2])) and not np.all(apart(u[1::2]))


def test_levels_are_held_as_long_as_is_asked(known):
    """Of 120 samples with holds of 8, in stretches of 6: each input moves once in a
    stretch at most, and in three of four if it were by chance alone."""
    asked = {"rates": {"load": 1e6}, "forbidden": [], "limits": None}
    held = made(known, hold=(8 * TIME, 8 * TIME), **asked)
    assert len(held.stats["start"]) == 20
    moves = np.count_nonzero(np.diff(held.value.inputs[:, 1]))
    assert 8 <= moves <= 20


def test_limits_are_those_of_the_training_unless_they_are_told(known):
    limits = limits_for(known, None, None, (), None)
    np.testing.assert_allclose(limits.low, np.asarray(known.low)[:3])
    np.testing.assert_allclose(limits.rate, np.asarray(known.domain.rate))
    told = limits_for(
        known, RANGES, {"load": 3}, ["load>1&speed < 0"], {"temp": (-1, 2)}
    )
    assert told.rate[1] == 3 * TIME and told.low[0] == -3
    u = np.array([[-1.0, 1.5, 0], [1, 1.5, 0], [-1, 0.5, 0]])
    assert told.allows(u).tolist() == [False, True, True]
    room = told.room(np.array([[1.5], [-2.0], [np.nan]]), np.full((3, 1), 0.1))
    np.testing.assert_allclose(room[:2, 0], [0.4, -1.1])
    assert room[2, 0] == -np.inf


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ranges": {"spead": (0, 1)}}, "Did you mean 'speed'"),
        ({"ranges": {"speed": (1, 1)}}, "low < high"),
        ({"rates": {"load": 0}}, "positive"),
        ({"rates": {"temp": 1}}, "no input"),
        ({"forbidden": ["speed = 3"]}, "speed > 3000 & load < 5"),
        ({"forbidden": ["temp > 3"]}, "no input"),
        ({"limits": {"speed": 1}}, "does not compute"),
        ({"limits": {"temp": (2, 1)}}, "highest value"),
        ({"limits": {"temp": -9}}, "there is no plan"),
        ({"forbidden": ["speed > -9"]}, "there is no plan"),
        ({"hold": (2, 1)}, "hold must be"),
        ({"hold": (0, 1)}, "hold must be of times above zero"),
    ],
)
def test_what_cannot_be_planned_is_told(known, options, message):
    with pytest.raises(SpecError, match=message):
        made(known, **options)


def test_a_network_without_a_domain_is_told_how_to_get_one(known):
    import dataclasses

    with pytest.raises(SpecError, match="fit_domain"):
        made(dataclasses.replace(known, domain=None))
    with pytest.raises(SpecError, match="duration"):
        jnx.design.plan(known, duration=0)
    bare = dataclasses.replace(known, errors=None)
    assert "without a margin" in made(bare).detail


def test_the_command_writes_what_simulate_and_check_read(
    known, tmp_path, capsys, monkeypatch
):
    monkeypatch.delenv("JAXNARX_DATA", raising=False)
    model, out = str(tmp_path / "m.safetensors"), tmp_path / "plan"
    jnx.save(known, model)
    words = ["plan", model, "--duration", "1min", "--out", str(out), "--seed", "1"]
    words += ["--range", "speed=-3:4", "load=-2:2", "--rate", "speed=1"]
    words += ["--forbid", FORBIDDEN, "--limit", "temp=2"]
    assert run(words) == 0
    told = capsys.readouterr().out
    assert "information" in told and "plan.csv" in told and "outside" in told
    data = jnx.read(out / "plan.toml")
    np.testing.assert_array_equal(data.records[0].u, made(known).value.inputs)
    assert data.channels.inputs[0].unit == "rpm" and data.sample_time == TIME
    assert run(["simulate", model, str(out / "plan.csv"), "--out", str(out / "s")]) == 0
    assert run(["check", str(out / "plan.toml"), "--model", model]) == 0
    capsys.readouterr()
    assert run(words) == 2 and "--force" in capsys.readouterr().err
    for wrong, message in (
        (["--duration", "soon"], "20min"),
        (["--duration", "1min", "--range", "speed"], "NAME=LOW:HIGH"),
        (["--duration", "1min", "--range", "sped=0:1"], "'speed'"),
        (["--duration", "1min", "--limit", "temp=x"], "NAME=HIGHEST"),
        (["--duration", "1min", "--hold", "4s", "long"], "--hold"),
        (["--duration", "1min", "--hold", "4s", "2s"], "--hold must be"),
    ):
        assert run(["plan", model, *wrong, "--out", str(tmp_path / "x")]) == 2
        assert message in capsys.readouterr().err
