"""Candidates with hidden states: what is tried, judged, kept and not tried again."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.signal import lfilter
from search_problems import LENGTHS, made, plant

import jaxnarx as jnx
from jaxnarx.data import Dataset, groups
from jaxnarx.errors import DataError
from jaxnarx.identification import candidates as module
from jaxnarx.identification import cross_validate as judging
from jaxnarx.identification import search
from jaxnarx.identification import state_space_candidates as module_of_methods
from jaxnarx.identification.candidates import CandidateSearch
from jaxnarx.identification.cross_validate import CrossValidation
from jaxnarx.identification.leaderboard import Candidate
from jaxnarx.identification.state_space_candidates import (
    BANK_FACTOR,
    BANK_GATES_TRIED,
    BANK_STATES,
    FAMILY_NAME,
    FEW_INPUTS,
    GATE_PULLS,
    GATED_FAMILY,
    GATES_TRIED,
    LONG_BANK_PULLS,
    LONG_GATE_PULLS,
    LONG_GATE_RIDGE,
    LONG_RECORDS,
    MANY_INPUTS,
    MOST_COEFFICIENTS,
    MOST_LINEAR_STATES,
    PULLS_TRIED,
    REGION_STATES,
    SAMPLES_PER_COEFFICIENT,
    SHORT_PULLS,
    SHORT_RECORDS,
    SHORT_SATURATION,
    UNASKED_INPUTS,
    WINDOW_LIMITS,
    propose_gates,
    propose_state_space,
)
from jaxnarx.partition import ClosedSearch, profile_data
from jaxnarx.settings import PRESETS, HiddenStates, Preset

TINY = Preset("for tests", max_models=2, grown=1, fed_back=0, states=2)
"""Two structures with hidden states."""


def wide(inputs: int, rows: int) -> Dataset:
    """Noise."""
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=(rows, inputs)), rng.normal(size=(rows, 1))
    names = [f"u{n}" for n in range(inputs)]
    return Dataset.from_arrays([u], [y], inputs=names, outputs=["y"], sample_time=0.1)


def sizes(data: Dataset, preset: Preset = TINY) -> list[tuple[int, int]]:
    """Number of states and degree of what is tried without regions."""
    found = [method for *_, method in propose_state_space(data, "y", preset)]
    return [(method.states, method.degree) for method in found if method.regions == 1]


# what is tried --------------------------------------------------------------------


def test_a_method_has_a_name_for_every_pull_and_number_of_regions():
    data, seen = plant(2), []
    for family, names, method in propose_state_space(data, "y", TINY):
        assert family == FAMILY_NAME and method.outputs == ("y",)
        assert method.shrink == (SHORT_PULLS if method.regions == 1 else PULLS_TRIED)
        for name, (regions, pull) in zip(names, method.stages, strict=True):
            kind = f"degree {method.degree}" if regions == 1 else f"{regions} regions"
            stays = regions == 1 and method.degree > 1
            assert method.saturation == (SHORT_SATURATION if stays else 0)
            kind += f", saturated at {SHORT_SATURATION:g}" if stays else ""
            assert name == f"{method.states} states, {kind}, pull {pull:g}"
        seen += names
    assert len(set(seen)) == len(seen) >= 6
    _, _, long = next(propose_state_space(wide(1, SHORT_RECORDS + 1), "y", TINY))
    assert long.shrink == PULLS_TRIED and long.saturation == 0


def test_orders_that_are_asked_for_are_the_only_ones():
    asked = dataclasses.replace(TINY, orders=(3, 1))
    found = sizes(wide(1, 5000), asked)
    assert found == [(3, 3), (3, 2), (3, 1), (1, 3), (1, 2), (1, 1)]
    # Many inputs hold nobody back who asks.
    many = sizes(
        wide(UNASKED_INPUTS + 1, 5000), dataclasses.replace(asked, orders=(1,))
    )
    assert many == [(1, 2), (1, 3), (1, 1)]


def test_many_inputs_are_not_tried_unasked():
    data = wide(UNASKED_INPUTS + 1, 5000)
    assert sizes(data) == []
    assert sizes(data, dataclasses.replace(TINY, rule="best"))


def test_a_linear_model_says_how_many_states_are_tried_first():
    """A resonance behind a lag: three poles, and noise."""
    rng, n = np.random.default_rng(0), 3000
    u = rng.normal(size=(n, 1))
    b, a = np.array([0.0, 0.1]), np.poly([0.9, 0.8 + 0.4j, 0.8 - 0.4j]).real
    y = np.asarray(lfilter(b, a, u[:, 0]))[:, None]
    y += 0.01 * y.std() * rng.normal(size=y.shape)
    assert sizes(made([u], [y]))[:2] == [(3, 3), (3, 2)]


def test_short_records_begin_with_products_of_two():
    found = sizes(wide(1, SHORT_RECORDS))
    assert found.index((2, 2)) < found.index((2, 3)) < found.index((3, 2)) < 5
    long = sizes(wide(1, SHORT_RECORDS + 1))
    assert long.index((2, 3)) < long.index((2, 2))


def regional(data: Dataset, preset: Preset = TINY) -> list[tuple[int, int]]:
    """Where in the list regions are tried, and of how many states."""
    every = [method for *_, method in propose_state_space(data, "y", preset)]
    assert all(m.degree == 1 for m in every if m.regions > 1)
    return [(n, m.states) for n, m in enumerate(every) if m.regions > 1]


def test_short_records_try_regions_in_turn_with_products():
    data = wide(1, SHORT_RECORDS)
    found, every = regional(data), list(propose_state_space(data, "y", TINY))
    assert sorted(states for _, states in found) == list(range(1, 1 + REGION_STATES))
    for place, states in found:  # right behind the first product of as many states
        first = next(n for n, (*_, m) in enumerate(every) if m.states == states)
        assert place == first + 1 and every[first][2].regions == 1
    assert not regional(wide(1, SHORT_RECORDS + 1)) and not regional(
        wide(UNASKED_INPUTS + 1, SHORT_RECORDS)
    )
    # First as many states as a linear model asks for, then one less.
    (first, own), (second, less) = found[:2]
    assert (first, second) == (1, 3) and less == (own - 1 or 2)
    asked = dataclasses.replace(TINY, orders=(1, 5))
    assert [states for _, states in regional(wide(1, SHORT_RECORDS), asked)] == [1, 5]
    # 200 samples bear 33 coefficients: of two states twelve a region, but no two of
    # three or four states, of 20 and 30.
    found = [
        m for *_, m in propose_state_space(wide(1, 200), "y", TINY) if m.regions > 1
    ]
    assert [(m.states, m.regions) for m in found] == [(1, 3), (2, 2)]


@pytest.mark.parametrize(("inputs", "rows"), [(1, 600), (1, 5000), (2, 10_000)])
def test_there_are_samples_enough_for_the_coefficients(inputs, rows):
    def count(states, degree):
        return (states + 1) * math.comb(states + inputs + degree, degree)

    most = min(MOST_COEFFICIENTS, rows / SAMPLES_PER_COEFFICIENT)
    found = sizes(wide(inputs, rows))
    assert all(count(*one) <= most and one[0] <= 8 for one in found)
    # Behind what the linear model asks for come those of the list that the data bear.
    usual = [one for one in FEW_INPUTS if count(*one) <= most]
    assert usual and (rows > 600) == (len(usual) == len(FEW_INPUTS))
    assert set(usual) <= set(found) and len(found) <= len(usual) + 2
    assert all(n <= MOST_LINEAR_STATES for n, _ in set(found) - set(usual))


@pytest.mark.parametrize(
    ("lengths", "window"),
    [((120,), 10), ((1000, 3000), 25), ((9000,), WINDOW_LIMITS[1])],
)
def test_the_window_is_a_share_of_the_shortest_record(lengths, window):
    rng = np.random.default_rng(0)
    signals = [rng.normal(size=(n, 1)) for n in lengths]
    every = list(propose_state_space(made(signals, signals), "y", TINY))
    assert every and {method.window for _, _, method in every} == {window}


def test_presets_try_them_as_they_say():
    for name in ("linear", "ecu", "quick"):
        assert PRESETS[name].states == 0
    counts = [PRESETS[name].states for name in ("good", "best")]
    assert counts == sorted(counts) and counts[0] > 0
    assert counts[-1] <= len({*FEW_INPUTS, *MANY_INPUTS})


def test_gates_of_many_inputs_begin_as_a_bank_of_lags():
    data = wide(UNASKED_INPUTS + 1, 3000)
    seen = dataclasses.replace(profile_data(data, "y"), memory=400, begin=300)
    good = dataclasses.replace(TINY, gates=2)
    found = list(propose_gates(data, seen, good))
    assert [m.gates for *_, m in found] == [gates for gates, _ in BANK_GATES_TRIED[:2]]
    for family, names, method in found:
        assert family == GATED_FAMILY and len(set(names)) == len(method.shrink)
        # A seventh of the memory is the slowest; each other is 4.5 times faster.
        assert method.states == len(method.times) == BANK_STATES
        np.testing.assert_allclose(method.times[-1], 40 / 7)
        np.testing.assert_allclose(np.diff(np.log(method.times)), np.log(BANK_FACTOR))
        assert method.window == 57 and method.stretch == 20 * 57
        assert method.shrink == GATE_PULLS
    long = dataclasses.replace(seen, memory=4)
    methods = [m for *_, m in propose_gates(wide(3, LONG_RECORDS + 1), long, good)]
    assert (
        methods[0].times == pytest.approx((0.4 / 7,))
        and methods[0].shrink == LONG_BANK_PULLS
    )
    short = [m for *_, m in propose_gates(wide(3, SHORT_RECORDS), seen, good)]
    assert short and not any(method.times for method in short)


def test_gates_of_few_inputs_begin_from_subspace_identification():
    data = wide(1, 3000)
    seen = profile_data(data, "y")
    good = dataclasses.replace(TINY, gates=2)
    methods = [method for *_, method in propose_gates(data, seen, good)]
    assert [m.gates for m in methods[:: len(methods) // 2]] == [
        gates for gates, _ in GATES_TRIED[:2]
    ]
    assert not any(method.times for method in methods) and methods[-1].states == 2
    assert {m.shrink for m in methods} == {GATE_PULLS}
    long = wide(1, LONG_RECORDS + 1)
    longest = [m for *_, m in propose_gates(long, seen, good)]
    assert longest[0].states == longest[1].states + 1
    assert {(m.shrink, m.ridge) for m in longest} == {
        (LONG_GATE_PULLS, LONG_GATE_RIDGE)
    }
    best = dataclasses.replace(good, rule="best")
    three = wide(3, 3000)
    both = list(propose_gates(three, profile_data(three, "y"), best))
    assert {bool(method.times) for *_, method in both} == {True, False}
    asked = dataclasses.replace(good, orders=(2,))
    assert {m.states for *_, m in propose_gates(data, seen, asked)} == {2}
    assert not list(propose_gates(data, seen, dataclasses.replace(good, gates=0)))


# how they are tried ---------------------------------------------------------------


@pytest.fixture(scope="module")
def closed():
    """The mean, and the look at the data."""
    data = plant()
    seen = profile_data(data, "y")
    return data, seen, ClosedSearch(data, seen, groups(data)).constant()


@pytest.fixture
def asked(monkeypatch, closed) -> dict:
    """Methods that the judge was asked for; it gives `results` in turn."""
    said: dict = {"asked": [], "results": []}

    class Fake(ClosedSearch):
        spread = 1.5  # pyright: ignore

        def __init__(self, *_, root=False, **known):
            pass

        def candidates(self, **_):  # pyright: ignore
            yield closed[2]

    def judge(method, *_, **__):
        said["asked"].append(method)
        result = said["results"].pop(0)
        if isinstance(result, Exception):
            raise result
        return result

    monkeypatch.setattr(module, "ClosedSearch", Fake)
    monkeypatch.setattr(module, "cross_validate", judge)
    monkeypatch.setattr(module, "judge_nested", lambda rows, *_: list(rows))
    return said


def outcome(closed, *errors: float | None) -> list[CrossValidation]:
    """One network for every error; None: given up."""
    counts = np.full(4, 100.0)
    network = closed[2].network()
    return [
        CrossValidation(np.full(4, np.nan), counts, np.nan, 0, None, "given up")
        if e is None
        else CrossValidation(np.full(4, e**2), counts, 0.1, 0, network)
        for e in errors
    ]


def tried(closed, **more) -> list[Candidate]:
    """Rows of all candidates but the mean."""
    data, seen, _ = closed
    return [row for row, _ in CandidateSearch(data, seen, groups(data), TINY, **more)][
        1:
    ]


def test_every_pull_is_a_candidate_with_a_model_of_its_own(closed, asked):
    expected = [names for _, names, _ in propose_state_space(closed[0], "y", TINY)][:2]
    second, first = (0.3, 0.2, None, 0.7), (0.5, 0.6, 0.4, 0.8, 0.9, 0.45)
    assert [len(first), len(second)] == [len(names) for names in expected]
    asked["results"] = [outcome(closed, *first), outcome(closed, *second)]
    rows = tried(closed)
    assert [row.free_run for row in rows] == pytest.approx([*first, *second])
    assert [row.status for row in rows] == [
        "skipped" if error is None else "ok" for error in (*first, *second)
    ]
    assert {row.family for row in rows} == {FAMILY_NAME}
    assert [row.name for row in rows] == sum(expected, [])
    assert [m.regions for m in asked["asked"]] == [3, 1]
    assert all(row.seconds is not None for row in rows)


def test_a_search_that_goes_on_does_not_try_them_again(closed, asked):
    first = outcome(closed, 0.3, 0.2, None, 0.7, 0.4, 0.5)
    asked["results"] = [first, DataError("no start of 3 hidden states")]
    rows = tried(closed)
    # Of a method that cannot be trained there is one row, under its first name.
    assert [row.status for row in rows] == [
        *("ok", "ok", "skipped", "ok", "ok", "ok", "failed")
    ]
    assert len(asked["asked"]) == 2
    again = tried(closed, known=rows)
    assert not again and len(asked["asked"]) == 2, "nothing was left to be tried"
    # Cut short between the candidates of one method: that method is trained again.
    asked["results"] = [first]
    part = tried(closed, known=[rows[0], rows[6]])
    assert [row.name for row in part] == [row.name for row in rows[:6]]
    assert len(asked["asked"]) == 3


def test_failed_ones_do_not_count_as_near(closed, asked, monkeypatch):
    asked["results"] = [DataError("too short"), DataError("too short")]
    rows = tried(closed)
    monkeypatch.setattr(module, "SHORT_RECORDS", 0)  # of short records all are tried
    impatient = dataclasses.replace(TINY, states=3, patience=2)
    data, seen, _ = closed
    found = CandidateSearch(data, seen, groups(data), impatient, known=rows)
    assert len(list(found)) == 1 and len(asked["asked"]) == 2


# judged on groups left out --------------------------------------------------------


def measured(data) -> int:
    """How many outputs."""
    return sum(int(r.valid[:, -1].sum()) for r in data)


@pytest.fixture
def fits(monkeypatch, closed):
    """Training replaced: what it was asked for, and constants for networks. Without the
    second group the last pull fails."""
    from jaxnarx.solution import RESULTS, Solution

    # With the measured outputs there were, and from how many trainings it came.
    calls: dict = {"all": [], "again": [], "from": []}
    networks = [
        dataclasses.replace(closed[2].network(), window=n)
        for n in range(len(PULLS_TRIED))
    ]

    def fit(data, method, hopeless=np.inf):
        calls["all"].append((method, measured(data)))
        return Solution(networks[-1], RESULTS.ok, {"path": networks, "start": ""})

    def refit(network, data, method, shrink):
        calls["again"].append((shrink, measured(data)))
        calls["from"].append(network.window)
        if calls["again"][-1] == (PULLS_TRIED[-1], sum(LENGTHS) - LENGTHS[1]):
            raise DataError("runs away")
        return dataclasses.replace(network, window=network.window + 10)

    monkeypatch.setattr(judging, "fit_states", fit)
    monkeypatch.setattr(judging, "refit_states", refit)
    return calls


METHOD = HiddenStates(outputs=("y",), shrink=PULLS_TRIED)


def test_without_a_group_the_first_trains_from_where_it_stands_others_on(closed, fits):
    data = closed[0]
    found = judging.cross_validate(METHOD, data, groups(data), 1.0)
    assert fits["all"] == [(METHOD, sum(LENGTHS))]
    rest = [sum(LENGTHS) - n for n in LENGTHS]
    # What cannot be trained without a group is not tried without the others.
    pulls = [(PULLS_TRIED[0], *PULLS_TRIED)[: 3 + (g < 2)] for g in range(len(rest))]
    expected = [(p, n) for own, n in zip(pulls, rest, strict=True) for p in own]
    assert fits["again"] == expected
    # The network of the strongest pull, then what has come of it without the group.
    assert fits["from"] == [0, 10, 20, 30, 0, 10, 20, 30, 0, 10, 20, 0, 10, 20]
    assert [one.complete for one in found] == [True, True, False]
    assert (found[2].diverged, found[2].detail) == (1, "diverges")
    assert all(
        one.network is not None and one.network.hold is not None for one in found[:2]
    )


def test_behind_a_training_that_fails_the_next_starts_from_where_it_stands(
    monkeypatch, closed
):
    asked = []

    def again(network, method, pull, *data):
        asked.append(network)
        return None if pull == PULLS_TRIED[0] else network

    monkeypatch.setattr(judging, "refit", again)
    networks, data = [closed[2].network() for _ in PULLS_TRIED], closed[0]
    found = judging.refit_stages(networks, METHOD, data, data)
    assert asked == [networks[0], networks[1], networks[1], networks[1]]
    assert found == [None, networks[1], networks[1]]


def test_every_number_of_regions_starts_from_where_it_stands(monkeypatch, closed):
    asked = []

    def again(network, method, pull, *data):
        asked.append((network, pull))
        return network

    monkeypatch.setattr(judging, "refit", again)
    method = dataclasses.replace(METHOD, degree=1, regions=3, shrink=(0.1, 0.01))
    networks, data = [closed[2].network() for _ in method.stages], closed[0]
    found = judging.refit_stages(networks, method, data, data)
    assert asked == [(networks[at], pull) for at in (0, 2) for pull in (0.1, 0.1, 0.01)]
    assert found == [networks[0], networks[0], networks[2], networks[2]]


def test_an_error_in_training_beyond_the_best_leaves_nothing_out(closed, fits):
    data = closed[0]
    best = np.full(4, 1e-4)
    found = judging.cross_validate(METHOD, data, groups(data), 1.0, best)
    assert len(fits["all"]) == 1 and not fits["again"] and len(found) == 3
    assert all("error in training" in one.detail for one in found)
    assert not any(one.complete for one in found)
    assert all(np.all(np.isnan(one.losses)) for one in found)


# the real thing -------------------------------------------------------------------


@pytest.mark.slow
def test_a_plant_with_a_hidden_state_is_judged_as_it_is():
    rng, us, ys = np.random.default_rng(4), [], []
    for n in (150, 160, 140, 155):
        u, z, y = np.repeat(rng.uniform(-1, 1, n // 5 + 1), 5)[:n], 0.0, np.zeros(n)
        for t in range(n):
            y[t] = z + 0.3 * z**2
            z = 0.8 * z + 0.4 * u[t]
        us.append(u[:, None])
        ys.append((y + 1e-3 * rng.normal(size=n))[:, None])
    data = made(us, ys)
    method = HiddenStates(outputs=("y",), states=1, shrink=(1e-2, 1e-4), window=10)
    spread = float(np.concatenate(ys).std())
    found = judging.cross_validate(method, data, groups(data), spread)
    assert len(found) == 2
    for one in found:
        assert one.complete and one.network is not None and one.network.hidden == 1
        # Ten parameters of 600 samples: the noise, and not much more. Of records left
        # out one goes farther than the others.
        errors = np.sort(np.sqrt(one.losses)) * spread
        assert np.all(errors[:3] < 2e-3) and errors[3] < 0.02
        assert np.all(one.counts > 100)


@pytest.mark.slow
def test_a_search_goes_on_behind_the_methods_that_are_done(monkeypatch, tmp_path):
    few = dataclasses.replace(TINY, orders=(1,), patience=9, rule="best")
    monkeypatch.setitem(PRESETS, "tiny", few)
    monkeypatch.setattr(search, "cores", lambda: 1)
    for name, pulls in (("SHORT_PULLS", (0.3, 0.001)), ("PULLS_TRIED", (0.1, 0.001))):
        monkeypatch.setattr(module_of_methods, name, pulls)
    asked = []

    def judge(method, *args, **more):
        asked.append((method.states, method.degree, method.regions))
        return judging.cross_validate(method, *args, **more)

    monkeypatch.setattr(module, "cross_validate", judge)

    def stop(event):
        row = event.get("row")
        if row is not None and row.family == FAMILY_NAME and row.name.endswith("0.001"):
            raise KeyboardInterrupt

    folder = tmp_path / "run"
    cut = jnx.identify(plant(), preset="tiny", folder=folder, progress=stop)
    assert cut.status_name == "budget_spent" and asked == [(1, 2, 1)]
    done = jnx.identify(plant(), preset="tiny", folder=folder)
    assert done.is_okay and asked == [(1, 2, 1), (1, 1, 3)]
    rows = [row for row in done.stats["leaderboard"] if row.family == FAMILY_NAME]
    names = [names for _, names, _ in propose_state_space(plant(), "y", few)][:2]
    assert [row.name for row in rows] == sum(names, [])
    assert len({row.number for row in rows}) == len(rows)
    assert all(row.status in ("ok", "skipped", "diverged") for row in rows)
