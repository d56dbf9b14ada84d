"""The report: what it shows, what it refuses to show, and what it warns about."""

import dataclasses
import json
import types

import numpy as np
import pytest

from jaxnarx.data import Channel, Channels, Dataset, Record
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import Report, metrics, report, reporting
from jaxnarx.evaluation.remarks import score_notes

CHANNELS = Channels(
    (Channel("speed", "rpm"),), (Channel("NOx", "ppm"), Channel("torque", "Nm"))
)


@dataclasses.dataclass(frozen=True)
class Trajectories:
    outputs: tuple
    scored: tuple
    limited: tuple
    held: tuple
    extrapolated: tuple
    diverged: tuple
    names: list
    output_names: list


@dataclasses.dataclass(frozen=True)
class Network:
    """Stands in for a network: its error is known, and `lost` records diverge."""

    error: float = 0.1
    lost: tuple = ()
    output_channels: tuple = CHANNELS.outputs
    output_names = ("NOx", "torque")
    channels: Channels = CHANNELS
    models: tuple = (None, None)

    def equations(self, style="text"):
        term = ("speed[t-1]", 2.0)
        return [
            {"output": n, "model": 0, "region": {}, "terms": [term]}
            | {style: "2 speed[t-1]"}
            for n in self.output_names
        ]

    def run(self, data, k):
        scored = [r.valid[:, -2:].copy() for r in data]
        for mask in scored:
            mask[:3] = False
        shape = [r.y.shape for r in data]
        diverged = [np.full(2, k is None and r.name in self.lost) for r in data]
        size = self.error * (3 if k is None else 1)
        wave = [size * np.cos(np.arange(len(r)))[:, None] for r in data]
        run = Trajectories(
            tuple(r.y + w for r, w in zip(data, wave, strict=True)),
            tuple(scored),
            tuple(map(np.broadcast_to, diverged, shape)),
            tuple(np.zeros(s, bool) for s in shape),
            tuple(np.zeros(len(r), bool) for r in data),
            tuple(diverged),
            data.names,
            list(self.output_names),
        )
        return types.SimpleNamespace(value=run, status="ok", stats={})


@pytest.fixture(autouse=True)
def verbs(monkeypatch):
    monkeypatch.setattr(
        reporting, "predict", lambda network, data, k=1: network.run(data, k)
    )
    monkeypatch.setattr(
        reporting, "simulate", lambda network, data: network.run(data, None)
    )


def make(seed, records=3, channels=CHANNELS, constant=False):
    rng = np.random.default_rng(seed)
    out = []
    for i in range(records):
        n = 60 + 20 * i
        y = rng.normal(size=(n, 2)) * [30.0, 5.0] + [200.0, 50.0]
        if constant:
            y[:, 1] = 7.0
        u = rng.normal(size=(n, len(channels.inputs)))
        valid = np.ones((n, u.shape[1] + 2), bool)
        out.append(Record(u, y, valid, f"r{seed}{i}"))
    return Dataset(tuple(out), channels, 0.1)


@pytest.fixture
def full() -> Report:
    parts = {"train": make(1), "validate": make(2), "test": make(3)}
    return report(Network(lost=("r31",)), parts)


def test_pooled_rows_are_the_metrics_of_the_concatenation():
    data = make(4)
    network = Network()
    got = report(network, data)
    run = network.run(data, None).value
    joined = (np.concatenate(x) for x in ([r.y for r in data], run.outputs, run.scored))
    want = metrics.scores(*joined)
    for o, name in enumerate(("NOx", "torque")):
        row = got.pooled_row(name)
        for metric in metrics.PERFECT_VALUES:
            assert getattr(row, metric) == pytest.approx(want[metric][o], rel=1e-12)
        assert row.samples == want["samples"][o] and row.status == "ok"
    assert got.modes == ("one step", "10 steps", "free run") and got.main == "data"
    assert len(got.rows) == 2 * 4 * 3


def test_divergence_is_a_status_never_a_number(full):
    row = full.pooled_row("NOx")
    assert row.status == "diverged (1 of 3)" and row.nrmse is None
    assert row.others is not None and row.others["nrmse"] > 0
    assert row.limited == 77
    assert full.pooled_row("NOx", mode="one step").status == "ok"
    assert "diverged (1 of 3)" in full.table and "nan" not in full.table.lower()
    note = next(n for n in full.notes if "diverged" in n)
    assert "r31" in note and "The others alone: RMSE" in note
    assert full.traces[0].rank == "worst" and full.traces[0].record == "r31"
    assert full.traces[0].rmse is None


def test_all_records_diverged_leaves_no_figure():
    got = report(Network(lost=("r40", "r41", "r42")), make(4))
    assert got.pooled_row("NOx").others is None
    assert got.residuals[0].counts.size == 0
    json.dumps(got.to_dict(), allow_nan=False)


def test_nonfinite_predictions_count_as_diverged():
    got = report(Network(error=np.inf), make(4))
    assert got.pooled_row("NOx").status == "diverged (3 of 3)"


def test_dict_is_strict_json(full):
    extras = {
        "selection": {"names": ["a"], "err": np.array([0.5]), "cumulative": [np.nan]},
        "history": [{"iteration": np.int64(0), "loss": np.inf, "validation": None}],
        "partition": {"scheduling": ["z"], "ranges": [(0, 1)], "cloud": np.ones(9)},
    }
    values = dataclasses.replace(full, **extras).to_dict()
    text = json.dumps(values, allow_nan=False)
    back = json.loads(text)
    assert back["history"][0]["loss"] == "inf"
    assert back["selection"]["cumulative"] == [None]
    assert "cloud" not in back["partition"]
    row = back["rows"][0]
    assert {"part", "record", "output", "mode", "rmse", "status"} <= set(row)
    assert all("total_error" in row for row in back["rows"])
    told = {
        r["total_error"] for r in back["rows"] if r["status"].startswith("diverged")
    }
    assert told == {None} and back["verdict"]["rules"]
    assert len(back["provenance"]["test data"].split("sha256 ")[1]) == 64


def test_table_is_aligned_and_fits_a_terminal(full):
    assert max(map(len, full.table.split("note:")[0].splitlines())) <= 100
    for block in full.table.split("note:")[0].split("\n\n")[1:]:
        lines = block.strip().splitlines()[1:]
        assert max(map(len, lines)) <= 100
        ends = {len(x) for x in lines if x.split()[-1].isdigit() and "diver" not in x}
        assert len(ends) == 1
    assert str(full) == full.table


def test_the_table_tells_the_main_part_first_and_its_worst_records():
    got = report(Network(), {"train": make(1), "test": make(3, records=5)})
    told = got.table
    assert told.index("test data") < told.index("train data")
    for output in ("NOx", "torque"):
        block = told[told.index(f"{output} [") :].split("\n\n")[0]
        errors = {
            r.record: r.rmse or 0.0
            for r in got.rows
            if (r.part, r.output, r.mode) == ("test", output, "free run")
        }
        single = sorted(
            (e for name, e in errors.items() if name != "pooled"), reverse=True
        )
        shown = [name for name in errors if f"\n{name} " in block]
        assert "pooled" in shown and len(shown) == 4
        assert sorted(errors[n] for n in shown if n != "pooled") == single[2::-1]
    train = told[told.index("train data") :]
    assert "r10" not in train and "pooled" in train


def test_validation_data_that_was_learned_from_is_noted_loudly():
    train = make(1)
    parts = {"train": train, "validate": make(2), "test": train[1:2]}
    notes = report(Network(), parts).notes
    assert notes[0].startswith("VALIDATION DATA EQUALS ESTIMATION DATA")
    assert "r11" in notes[0]
    same = {"train": train, "test": make(2), "validate": make(2)}
    assert report(Network(), same).notes[0].startswith("REPEATED DATA")


def test_clean_data_gives_no_notes():
    parts = {"train": make(1), "validate": make(2), "test": make(3)}
    assert report(Network(), parts).notes == ()


def test_errors_that_are_offsets_of_records_are_told(full):
    assert not any("offset of each record" in n for n in full.notes)
    rows = [
        dataclasses.replace(r, rmse=5.0, offset=4.0 if r.part == "test" else 1.0)
        for r in full.rows
        if r.output == "NOx" and not r.diverged
    ]
    (note,) = [n for n in score_notes(rows) if "offset" in n]
    # 4^2 of 5^2 in every record.
    assert note.startswith("NOx, test, free run: 64% of the error's mean square")


def test_errors_within_records_are_told_where_levels_hide_them(full):
    assert not any("within records" in n for n in full.notes)
    rows = [r for r in full.rows if r.mode == "free run" and r.part == "test"]
    flat = [
        dataclasses.replace(r, nrmse=3e-5, rmse=1.0)
        if r.record == "pooled"
        else dataclasses.replace(r, nrmse=1.2, rmse=1.0, status="ok")
        for r in rows
        if r.output == rows[0].output
    ]
    (note,) = [n for n in score_notes(flat) if "within records" in n]
    assert "NRMSE 3e-05 counts" in note and "it is 1.2" in note


def test_a_record_in_another_unit_is_told():
    data = make(1, records=6)
    records = list(data.records)
    records[2] = dataclasses.replace(records[2], u=records[2].u * 60)
    mixed = dataclasses.replace(data, records=tuple(records))
    notes = report(Network(), {"train": mixed, "test": make(2)}).notes
    (note,) = [n for n in notes if "Look at its unit" in n]
    assert f" in {records[2].name} goes from" in note


def test_masked_samples_are_counted():
    """What `prepare --hampel` removed, or the file lacked, is told by part."""
    data = make(2)
    valid = data.records[0].valid.copy()
    valid[10:16, 1] = False
    records = (dataclasses.replace(data.records[0], valid=valid), *data.records[1:])
    masked = dataclasses.replace(data, records=records)
    (note,) = report(Network(), {"train": make(1), "test": masked}).notes
    assert "Masked in test" in note and "NOx 6 (2.5 %)" in note


def test_constant_output_is_infinite_and_noted():
    got = report(Network(), make(5, constant=True))
    row = got.pooled_row("torque")
    assert row.nrmse == np.inf and row.fit == -np.inf
    assert row.status == "constant output"
    assert any("torque is constant" in n for n in got.notes)
    assert row.rmse is not None and row.rmse < 1


def test_a_record_too_short_to_predict_is_said_in_every_mode():
    long, short = make(1), make(2, records=1)
    rows = dataclasses.replace(
        short.records[0],
        **{k: getattr(short.records[0], k)[:2] for k in ("u", "y", "valid")},
    )
    data = Dataset((*long.records, rows), CHANNELS, 0.1)
    found = report(Network(), data, diagnostics=False, stability=False)
    row = [r for r in found.rows if r.record == "r20"]
    assert {r.status for r in row} == {"too short"} and all(r.samples == 0 for r in row)
    told = [n for n in found.notes if "record r20 is too short" in n]
    assert len(told) == len(row)
    assert found.pooled_row("NOx").status == "ok"


def test_other_units_and_extra_channels_are_noted():
    other = Channels(
        (Channel("speed", "km/h"), Channel("gear")),
        (Channel("NOx", "mg"), Channel("torque", "Nm")),
    )
    parts = {"train": make(1), "test": make(2, channels=other)}
    notes = report(Network(), parts).notes
    text = "\n".join(notes)
    assert "NOx is in ppm, the test data's in mg" in text
    assert "Extra channels in test, ignored: gear" in text
    assert "speed is in rpm, the test data's in km/h" in text
    assert len(notes) == 3


def test_ranks_and_residuals_describe_the_free_run():
    got = report(Network(), make(6, records=5))
    assert [t.rank for t in got.traces[:5]] == ["worst", "median", "best", "", ""]
    assert {t.record for t in got.traces[:5]} == set(make(6, records=5).names)
    rmses = [t.rmse for t in got.traces[:3] if t.rmse is not None]
    assert rmses == sorted(rmses, reverse=True)
    first = got.residuals[0]
    assert first.counts.sum() == got.pooled_row("NOx").samples
    assert [t.rank for t in report(Network(), make(6, records=1)).traces] == [
        "only",
        "only",
    ]


def test_a_known_free_run_is_not_simulated_again(monkeypatch):
    data = make(4)
    run = Network(error=0.5).run(data, None)
    monkeypatch.setattr(reporting, "simulate", None)
    got = report(Network(), data, simulated=run)
    again = report(Network(), {"test": data}, simulated={"test": run.value})
    assert got.pooled_row("NOx").rmse == again.pooled_row("NOx").rmse
    with pytest.raises(SpecError, match="this very data"):
        report(Network(), data[:1], simulated=run)


def test_wrong_requests_say_what_to_do():
    with pytest.raises(SpecError, match="no records"):
        report(Network(), {"test": make(1)[:0]})
    with pytest.raises(SpecError, match="whole numbers"):
        report(Network(), make(1), horizons=(0,))
    with pytest.raises(SpecError, match="Did you mean 'NOx'"):
        report(Network(output_channels=(Channel("NOX"),)), make(1))
