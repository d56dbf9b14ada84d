"""The whole search: the same again, gone on with, side by side, and cut short."""

import dataclasses
import os
import shutil
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from common import some
from search_problems import LENGTHS, plant

import jaxnarx as jnx
from jaxnarx.data import Groups, groups
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import cost
from jaxnarx.identification import Leaderboard, read_search, search
from jaxnarx.partition import ClosedForm, profile_data
from jaxnarx.refinement import rate_of
from jaxnarx.settings import PRESETS, Preset
from jaxnarx.solution import Solution

TINY = Preset("for tests", max_models=2, grown=1, fed_back=0, states=0)
LINEAR = 10
"""Candidates of the preset of linear models for one output."""


@pytest.fixture(scope="module")
def monkey():
    with pytest.MonkeyPatch.context() as patch:
        yield patch


@pytest.fixture(scope="module")
def tiny(monkey) -> str:
    """A preset that takes seconds."""
    monkey.setitem(PRESETS, "tiny", TINY)
    return "tiny"


@pytest.fixture(scope="module")
def whole(tiny, tmp_path_factory) -> tuple[Path, Solution]:
    """A search from beginning to end, and its folder."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, jnx.identify(plant(), preset=tiny, folder=folder)


@pytest.fixture
def one_core(monkeypatch):
    monkeypatch.setattr(search, "cores", lambda: 1)


def table(board: Leaderboard) -> list:
    """All of a leaderboard but the seconds."""
    rows = [dataclasses.replace(row, seconds=0.0) for row in board]
    return [*sorted(rows, key=lambda row: row.number), board.group_names, board.rule]


def board_of(found: Solution) -> Leaderboard:
    return found.stats["leaderboard"]


def saved(network: jnx.Network, place: Path) -> bytes:
    jnx.save(network, place)
    return place.read_bytes()


def stopped_after(count: int):
    """What raises Ctrl-C after so many candidates."""
    seen = []

    def progress(event):
        seen.extend([event["row"]] if "row" in event else [])
        if "row" in event and len(seen) == count:
            raise KeyboardInterrupt

    return progress


def test_the_choice_is_the_best_by_the_rule(whole):
    folder, found = whole
    board = board_of(found)
    assert found.is_okay and board.rule == "near" and len(board) >= 13
    chosen = board.choose("y")
    assert chosen is not None and chosen.family == "shared feedback"
    assert found.value.hold is not None and found.value.output_names == ["y"]
    kept = read_search(folder)
    assert table(kept.leaderboard) == table(board)
    own = kept.network(chosen.number)
    data = plant()
    for a, b in zip(
        jnx.simulate(own, data).value.outputs,
        jnx.simulate(found.value, data).value.outputs,
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


def test_the_model_knows_where_it_has_been_and_that_it_is_stable(whole):
    network = whole[1].value
    index = jnx.domain(network, plant()).value
    assert index.outside < 0.1
    assert network.certificate is not None and rate_of(network) < 1
    # as they are: what is stable for every input needs no narrow bound
    assert network.outside == "flag"
    reach = np.asarray(network.high - network.low)[network.signals[0]]
    assert float(network.upper[0] * network.gain[network.signals[0]]) > 50 * reach


def test_what_it_tells_of_records_left_out_is_about_so_on_new_ones(whole):
    _, found = whole
    chosen = board_of(found).choose("y")
    (fresh,) = plant(1, (*LENGTHS, 400)).records[4:]
    data = dataclasses.replace(plant(), records=(fresh,))
    run = jnx.simulate(found.value, data).value
    error = np.std(run.outputs[0] - fresh.y) / np.std(fresh.y)
    assert chosen is not None and chosen.free_run is not None
    assert 0.5 * chosen.free_run < error < 2 * chosen.free_run


def test_the_same_twice_is_the_same_to_the_byte(whole, tiny, tmp_path):
    folder, found = whole
    again = jnx.identify(plant(), preset=tiny, folder=tmp_path / "again")
    assert table(board_of(again)) == table(board_of(found))
    one, two = (saved(f.value, tmp_path / f"{n}") for n, f in enumerate((found, again)))
    assert one == two
    for path in sorted((folder / "candidates").glob("*.safetensors")):
        other = tmp_path / "again" / "candidates" / path.name
        assert path.read_bytes() == other.read_bytes()


@pytest.mark.parametrize("count", some((1, 6, 12), 6))
def test_killed_and_gone_on_with_is_the_same_table(whole, tiny, tmp_path, count):
    _, expected = whole
    folder = tmp_path / "run"
    cut = jnx.identify(
        plant(), preset=tiny, folder=folder, progress=stopped_after(count)
    )
    assert cut.status_name == "budget_spent" and "interrupted" in cut.detail
    assert len(board_of(cut)) == count
    assert cut.value.output_names == ["y"], "the best so far"
    told = []
    done = jnx.identify(plant(), preset=tiny, folder=folder, progress=told.append)
    assert table(board_of(done)) == table(board_of(expected))
    rows = [event["row"] for event in told if "row" in event]
    assert rows[-1].nested is not None
    assert len(rows) - 1 == len(board_of(done)) - count
    assert done.is_okay
    files = [saved(f.value, tmp_path / f"{n}") for n, f in enumerate((expected, done))]
    assert files[0] == files[1]


@pytest.mark.slow
def test_what_is_made_for_a_control_unit_is_certified():
    found = jnx.identify(plant(), preset="ecu")
    assert found.value.certificate is not None and found.value.errors is not None


def test_a_finished_search_has_nothing_left_to_do(whole, tiny):
    folder, found = whole
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    told = []
    again = jnx.identify(plant(), preset=tiny, folder=folder, progress=told.append)
    assert not told and table(board_of(again)) == table(board_of(found))
    assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before


def test_a_model_that_was_lost_is_made_again(whole, tiny, tmp_path):
    """Under a number of its own: no other's row or model goes."""
    folder, found = whole
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    for number in (2, 5):
        read_search(copy).model_path(number).unlink()
    again = jnx.identify(plant(), preset=tiny, folder=copy)
    names = {(row.family, row.name): row.free_run for row in board_of(found)}
    other = {(row.family, row.name): row.free_run for row in board_of(again)}
    assert other == names
    numbers = [row.number for row in board_of(again)]
    assert len(numbers) == len(set(numbers))
    for row in board_of(again):
        price = cost(read_search(copy).network(row.number))
        assert price.parameters == row.parameters, "the model is the row's"


def test_interrupted_before_anything_was_tried_it_stops(monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxnarx.identification.worker.CandidateSearch.__iter__", stop)
    with pytest.raises(KeyboardInterrupt):
        jnx.identify(plant(), preset="linear")


def test_events_tell_how_far_it_is(tiny):
    told = []
    found = jnx.identify(plant(), preset=tiny, candidates=4, progress=told.append)
    rows = [event["row"] for event in told if "row" in event]
    assert rows == list(board_of(found)) and len(rows) == 4
    after = [event for event in told if "row" in event]
    assert [event["done"] for event in after] == [1, 2, 3, 4]
    assert all(event["verb"] == "search" for event in told)
    for event in after:
        sofar = Leaderboard(tuple(rows[: event["done"]]), board_of(found).group_names)
        assert event["chosen"] == sofar.choose("y")
    before = [event for event in told if "trying" in event]
    assert before[0]["trying"].name == ""
    assert before[1]["trying"].name == "the next behind constant"
    assert {e["output"] for e in before} == {"y"}
    assert [e["number"] for e in before][:3] == [1, 2, 3]
    seconds = [event["seconds"] for event in after]
    assert seconds == sorted(seconds) and seconds[0] >= 0


def test_a_budget_too_small_for_anything_still_gives_a_model(tmp_path):
    told = jnx.identify(plant(), preset="linear", budget=1e-9, folder=tmp_path)
    assert told.status_name == "budget_spent" and told.is_okay
    assert "the budget ended the search of y" in told.detail
    (row,) = board_of(told)
    assert row.family == "constant" and told.value.history == 0
    run = jnx.simulate(told.value, plant()).value
    # Samples count behind the history of any candidate.
    begin = profile_data(plant(), "y").begin
    y = np.concatenate([r.y[begin:] for r in plant()])
    np.testing.assert_allclose(run.outputs[0], y.mean(), rtol=1e-9)
    # With more time the same call goes on.
    more = jnx.identify(plant(), preset="linear", folder=tmp_path)
    assert len(board_of(more)) == LINEAR
    assert list(board_of(more))[0] == row


def test_without_a_budget_the_clock_decides_nothing(tiny, whole, monkeypatch):
    def late(self, passed):
        """As `OutputTask._late` on a machine that is slower by a year."""
        return time.time() + 3.2e7 > self.until

    monkeypatch.setattr("jaxnarx.identification.worker.OutputTask._late", late)
    found = jnx.identify(plant(), preset=tiny)
    names = [(row.family, row.name) for row in board_of(found)]
    assert names == [(row.family, row.name) for row in board_of(whole[1])]


def test_where_all_are_vetoed_the_mean_is_given_with_its_reason(monkeypatch):
    monkeypatch.setattr(ClosedForm, "count_diverged", lambda one: 2)
    found = jnx.identify(plant(), preset="linear")
    assert found.status_name == "diverged" and "y diverges" in found.detail
    assert board_of(found).choose("y") is None and len(board_of(found)) == LINEAR
    assert found.value.history == 0, "the mean"
    run = jnx.simulate(found.value, plant())
    assert run.is_okay and np.ptp(run.value.outputs[0]) < 1e-9


def test_groups_are_those_that_were_given(tmp_path):
    data = plant()
    own = groups(
        data, named={"a": ["record 1", "record 3"], "b": ["record 2", "record 4"]}
    )
    found = jnx.identify(data, preset="linear", candidates=1, groups=own)
    assert board_of(found).group_names == ("a", "b")
    (row,) = board_of(found)
    a, b = (np.concatenate([data.records[n].y for n in at]) for at in ((0, 2), (1, 3)))
    spread = np.concatenate([a, b]).std()
    expected = [np.sqrt(np.mean((y - o.mean()) ** 2)) for y, o in ((a, b), (b, a))]
    np.testing.assert_allclose(
        np.array(row.groups, float), np.array(expected) / spread, rtol=0.05
    )
    assert isinstance(own, Groups)


def test_validation_is_a_group_of_its_own():
    data = plant()
    train, last = data[[0, 1, 2]], data[[3]]
    found = jnx.identify(train, preset="linear", candidates=1, validation=last)
    assert "validation" in board_of(found).group_names
    with pytest.raises(SpecError, match="groups and validation"):
        jnx.identify(train, validation=last, groups=groups(train))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (dict(preset="god"), "preset: there is no 'god'.*good"),
        (dict(budget=0.0), "budget must be a positive"),
        (dict(budget=np.nan), "budget must be a positive"),
        (dict(candidates=0), "candidates must be at least 1"),
        (dict(outputs=["z"]), "there is no output 'z'"),
    ],
)
def test_what_makes_no_sense_is_told(settings, words):
    with pytest.raises(SpecError, match=words):
        jnx.identify(plant(), **settings)


# several outputs --------------------------------------------------------------------


@pytest.fixture(scope="module")
def alone() -> Solution:
    """Two outputs, one after the other."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "cores", lambda: 1)
        return jnx.identify(plant(2), preset="linear")


def test_every_output_is_searched_as_if_it_were_alone(alone):
    board = board_of(alone)
    assert board.outputs == ["y", "w"] and len(board) == 2 * LINEAR
    assert [row.number for row in board.of("w")] and alone.value.output_names == [
        "y",
        "w",
    ]
    assert set(alone.stats["look"]) == {"y", "w"}
    only = jnx.identify(plant(2), preset="linear", outputs=["w"])
    assert only.value.channels.output_names == ["w"]
    own = {(r.family, r.name): r.free_run for r in board.of("w")}
    for row in board_of(only):
        assert row.free_run == pytest.approx(own[row.family, row.name], rel=1e-9)


def test_side_by_side_is_one_by_one(alone, monkeypatch):
    monkeypatch.setattr(search, "cores", lambda: 2)
    found = jnx.identify(plant(2), preset="linear")
    assert found.is_okay and found.value.output_names == ["y", "w"]
    pairs = zip(table(board_of(found))[:-2], table(board_of(alone))[:-2], strict=True)
    for a, b in pairs:
        assert (a.number, a.output, a.family, a.name) == (
            b.number,
            b.output,
            b.family,
            b.name,
        )
        # Threads of linear algebra sum in another order.
        assert a.free_run == pytest.approx(b.free_run, rel=1e-6)
        assert a.operations == b.operations
    for output in ("y", "w"):
        one, two = (board_of(f).choose(output) for f in (found, alone))
        assert one is not None and two is not None and one.name == two.name
    for a, b in zip(
        jnx.simulate(found.value, plant(2)).value.outputs,
        jnx.simulate(alone.value, plant(2)).value.outputs,
        strict=True,
    ):
        np.testing.assert_allclose(a, b, atol=1e-5)


def test_interrupted_in_the_first_output_the_second_has_none_yet(one_core, tmp_path):
    """What there is is returned, and no output is called diverging that never ran."""
    found = jnx.identify(
        plant(2), preset="linear", folder=tmp_path, progress=stopped_after(3)
    )
    assert found.status_name == "budget_spent" and "diverges" not in found.detail
    assert "w" in found.detail, "the output without a model is named"
    assert found.value.output_names == ["y"]
    done = jnx.identify(plant(2), preset="linear", folder=tmp_path)
    assert done.value.output_names == ["y", "w"] and done.is_okay
    assert len(board_of(done)) == 2 * LINEAR


@pytest.mark.slow
def test_interrupted_side_by_side_it_leaves_no_process(monkeypatch, tmp_path):
    monkeypatch.setattr(search, "cores", lambda: 2)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    started = []
    popen = subprocess.Popen

    def start(*args, **more):
        started.append(popen(*args, **more))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    found = jnx.identify(
        plant(2), preset="linear", folder=tmp_path / "run", progress=stopped_after(1)
    )
    assert found.status_name in ("budget_spent", "ok")
    assert len(started) == 2 and all(p.poll() is not None for p in started)


@pytest.mark.slow
def test_trouble_in_a_process_is_raised_here(monkeypatch):
    """With what it said."""
    monkeypatch.setattr(search, "cores", lambda: 2)
    monkeypatch.setenv("JAX_PLATFORMS", "nowhere")
    with pytest.raises(Exception, match="nowhere"):
        jnx.identify(plant(2), preset="linear", candidates=1)


SCRIPT = """
    import jax
    jax.config.update("jax_enable_x64", True)
    import numpy as np
    import jaxnarx as jnx
    rng = np.random.default_rng(0)
    u = [np.repeat(rng.uniform(-1, 1, (30, 1)), 5, axis=0) for _ in range(3)]
    y = [np.cumsum(v, axis=0) * [[0.1, -0.2]] for v in u]
    data = jnx.Dataset.from_arrays(
        u, y, inputs=["u"], outputs=["NOx/ppm", "w"], sample_time=0.1
    )
    found = jnx.identify(data, preset="linear", candidates=2)
    print(found.status_name, found.value.output_names)
"""


@pytest.mark.slow
@pytest.mark.parametrize("way", ["file", "input"])
def test_a_script_without_a_guard_may_search_several_outputs(tmp_path, way):
    """Processes do not import it; names of outputs are no names of files."""
    text = textwrap.dedent(SCRIPT)
    (tmp_path / "script.py").write_text(text)
    given = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run(
        [sys.executable, "script.py" if way == "file" else "-"],
        input=None if way == "file" else text,
        cwd=tmp_path,
        env=given,
        text=True,
        capture_output=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["ok", "['NOx/ppm',", "'w']"]
    assert not done.stderr.strip()
    assert [path.name for path in tmp_path.iterdir()] == ["script.py"]
