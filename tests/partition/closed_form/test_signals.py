"""What structures share, against loops over samples."""

import dataclasses

import nested_problems as problems
import numpy as np
from nested_problems import A_INPUT, B_INPUT, LONGEST, OUTPUT, SAMPLE_TIME

from jaxnarx.data import Dataset
from jaxnarx.partition.closed_form.signals import RunSignals, make_signals


def low_pass(u, time: float):
    """y(t) = p y(t-1) + (1 - p) u(t) from rest at the first value."""
    pole = np.exp(-SAMPLE_TIME / time)
    out, last = [], u[0]
    for value in u:
        last = pole * last + (1 - pole) * value
        out.append(last)
    return np.array(out)


def variables(record) -> np.ndarray:
    """Those of the pool from sample LONGEST on, by loops."""
    a, b = record.u.T
    slow = low_pass(a, 0.5)
    at = range(LONGEST, len(record))
    return np.array([[a[t - 1], a[t - 4], b[t - 2], slow[t]] for t in at]).T


def test_variables_are_centred_and_of_unit_spread():
    data, found = problems.records(), problems.signals()
    every = [variables(r) for r in data]
    rows = np.concatenate(every, axis=1)
    shift, size = rows.mean(axis=1)[:, None], rows.std(axis=1)[:, None]
    for one, v in zip(found.stretches, every, strict=True):
        assert np.all(one.z[0] == 1.0)
        np.testing.assert_allclose(one.z[1:], (v - shift) / size, atol=1e-9)


def test_scheduling_variables_go_from_zero_to_one():
    data, found = problems.records(), problems.signals()
    low, high = (f([f(r.u[:, A_INPUT]) for r in data]) for f in (np.min, np.max))
    for record, one in zip(data, found.stretches, strict=True):
        a, b = record.u.T
        at = np.arange(LONGEST, len(record))
        expected = (a[at - 1] - low) / (high - low)
        np.testing.assert_allclose(one.x[0], expected, atol=1e-11)
        np.testing.assert_array_equal(one.x[1], b[at - 2])
        slow = (low_pass(a, 0.5)[at] - low) / (high - low)
        np.testing.assert_allclose(one.x[2], slow, atol=1e-9)


def test_output_and_its_start():
    data, found = problems.records(), problems.signals()
    y = np.concatenate([r.y[LONGEST:, 0] for r in data])
    for record, one in zip(data, found.stretches, strict=True):
        scaled = (record.y[:, 0] - y.mean()) / y.std()
        np.testing.assert_allclose(one.y, scaled[LONGEST:], atol=1e-10)
        np.testing.assert_allclose(one.before, scaled[:LONGEST][::-1], atol=1e-10)
    gain = found.gain[OUTPUT]
    np.testing.assert_allclose(found.middle * gain, y.mean(), rtol=1e-12)
    np.testing.assert_allclose(found.spread * gain, y.std(), rtol=1e-9)


def test_every_third_sample_counts_in_the_group_of_its_record():
    for every in (1, 3):
        found = problems.signals(every)
        for one, group in zip(found.stretches, problems.LABELS, strict=True):
            for g, at in enumerate(one.counted):
                # Of the record, wherever its free run begins.
                rows = range(-LONGEST % every, len(one.y), every) if g == group else []
                assert at.tolist() == list(rows)


def test_every_stretch_knows_its_place():
    data, found = problems.records(), problems.signals()
    before = np.cumsum([0, *map(len, data)])[:-1]
    assert [one.first for one in found.stretches] == (before + LONGEST).tolist()


def made(data: Dataset, labels) -> RunSignals:
    return make_signals(
        data,
        problems.pool(),
        problems.SCHEDULING,
        labels,
        np.eye(1 + max(one.max() for one in labels), dtype=bool),
        history=LONGEST,
        every=1,
    )


def test_what_is_not_measured_counts_nowhere():
    """An output that is missing for a while, a gap between blocks, a short record."""
    data = problems.records()
    records = list(data.records)
    valid = records[1].valid.copy()
    valid[60:75, OUTPUT] = False
    records[1] = dataclasses.replace(records[1], valid=valid)
    records[2] = dataclasses.replace(
        records[2],
        **{k: getattr(records[2], k)[:LONGEST] for k in ("u", "y", "valid")},
    )
    labels = problems.labels()
    labels[0][80:90] = -1
    labels[2] = labels[2][:LONGEST]
    found = made(dataclasses.replace(data, records=tuple(records)), labels)
    assert len(found.stretches) == 3, "the record without a start is left out"
    gap, missing = (np.concatenate(one.counted) for one in found.stretches[:2])
    rows = np.arange(len(found.stretches[0].y)) + LONGEST
    expected = np.flatnonzero((rows < 80) | (rows >= 90))
    np.testing.assert_array_equal(np.sort(gap), expected)
    rows = np.arange(len(found.stretches[1].y)) + LONGEST
    expected = np.flatnonzero((rows < 60) | (rows >= 75))
    np.testing.assert_array_equal(np.sort(missing), expected)


def test_a_constant_channel_is_zero_and_has_no_spread():
    data = problems.records()
    still = [
        dataclasses.replace(r, u=r.u * [[1.0, 0.0]] + [[0.0, 3.3]], y=0 * r.y + 0.1)
        for r in data
    ]
    found = made(dataclasses.replace(data, records=tuple(still)), problems.labels())
    for one in found.stretches:
        assert np.all(np.abs(one.z[3]) < 1e-9) and np.all(np.abs(one.y) < 1e-9)
        assert np.all(np.isfinite(one.x[B_INPUT]))


def test_what_is_left_by_the_start_is_the_free_run_on_nothing():
    one, a = problems.signals().stretches[0], problems.FEEDBACK
    past, out = one.before[:2].tolist(), []
    for _ in range(30):
        past = [-a[1] * past[0] - a[2] * past[1], past[0]]
        out.append(past[0])
    np.testing.assert_allclose(one.start_response(a)[:30], out, atol=1e-12)
    assert not one.start_response(np.ones(1)).any()
