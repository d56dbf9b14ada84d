"""Several steps as one value: fitted in turn, applied to new data, damaged, refused."""

import dataclasses

import numpy as np
import pytest
from jaxtyping import TypeCheckError
from measurements import engine, levels, pooled, same

from jaxnarx.data import (
    Dataset,
    Decimate,
    Hampel,
    LowPass,
    Preparation,
    RemoveOffset,
    Resample,
    Scale,
    Shift,
    ToCrankAngle,
    ToTime,
    prepare,
)
from jaxnarx.errors import DataError, JaxnarxError, SpecError


def test_up_sampling_is_flagged():
    data = engine(600, gaps=False)
    _, finer = prepare(data, [Resample(sample_time=0.05)])
    said = str(finer.report)
    assert "warning: up-sampled from 600 to 1199 samples" in said
    assert "samples left" not in said
    _, coarser = prepare(data, [Decimate(factor=4)])
    assert "150 of 600 samples left" in str(coarser.report)


@pytest.fixture(scope="module")
def data() -> Dataset:
    return engine(150, 110, 200)


def test_steps_are_fitted_to_what_the_steps_before_left(data):
    done, preparation = prepare(data, [Hampel(), RemoveOffset(), Scale()])
    same(preparation.apply(data), done)
    same(preparation.physical(done), Hampel().fit(data).apply(data), rtol=1e-12)
    for j in range(2):
        assert (pooled(done, j).min(), pooled(done, j).max()) == (0.0, 1.0)
    with pytest.raises(SpecError, match="Hampel cannot be undone"):
        preparation.undo(done)


def test_new_data_have_no_say(data):
    """Ten times the speed: scaled by the training data's numbers, far beyond one."""
    _, preparation = prepare(data[0], [Scale()])
    other = dataclasses.replace(data.records[1], u=10 * data.records[1].u)
    new = preparation.apply(dataclasses.replace(data, records=(other,)))
    assert new.records[0].u.max() > 5


def test_two_preparations_are_one(data):
    first, early = prepare(data, [Hampel(), Decimate(factor=2)])
    done, late = prepare(first, [Scale()])
    same(late.prepend(early).apply(data), done)


def test_other_data_than_it_was_made_for_are_refused(data):
    _, preparation = prepare(data, [Scale()])
    with pytest.raises(SpecError, match="for samples of 0.1 s, the data have 0.2 s"):
        preparation.apply(dataclasses.replace(data, sample_time=0.2))
    with pytest.raises(SpecError, match="speed is in '-'.*prepared already"):
        preparation.apply(preparation.apply(data))
    with pytest.raises(SpecError, match="channel 'y'"):
        preparation.apply(dataclasses.replace(levels([1.0]), sample_time=0.1))
    with pytest.raises(SpecError, match="step 1 is 'scale'"):
        prepare(data, iter(["scale"]))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "change, words",
    [
        ({"format": 2}, "format 2"),
        ({"extra": 1}, "extra is missing or unknown"),
        ({"steps": [{"kind": "Scald"}]}, "Did you mean 'Scaled'"),
        ({"steps": [{"kind": ["Scaled"]}]}, "no preparation step"),
        ({"steps": [{"kind": "Decimate"}]}, "factor is missing"),
        ({"steps": [{"kind": "Decimate", "factor": 2.5}]}, "Decimate.factor must be"),
        ({"steps": [{"kind": "Decimate", "factor": True}]}, "Decimate.factor must be"),
        ({"steps": [{"kind": "Decimate", "factor": 1}]}, "from 2 on"),
        (
            {
                "steps": [
                    {"kind": "LowPass", "cutoff": "1", "order": 4, "channels": None}
                ]
            },
            "LowPass.cutoff must be",
        ),
        (
            {"steps": [{"kind": "LowPass", "cutoff": 1, "order": 4, "channels": [3]}]},
            "LowPass.channels must be",
        ),
        ({"steps": [{"kind": "Shift", "samples": {"y": 10**400}}, 3]}, "steps must be"),
        ({"sample_time": float("nan")}, "sample_time must be"),
        ({"sample_time": -1}, "positive"),
        ({"inputs": [["u"]]}, "2 entries"),
    ],
)
def test_a_damaged_preparation_is_one_clear_error(data, change, words):
    table = prepare(data, [Scale()])[1].to_dict()
    with pytest.raises(SpecError, match=words):
        Preparation.from_dict(table | change)


@pytest.mark.parametrize(
    "make, field",
    [
        (lambda: Scale(kind="max"), "kind"),  # type: ignore[arg-type]
        (lambda: RemoveOffset(kind="median"), "kind"),  # type: ignore[arg-type]
        (lambda: RemoveOffset(kind="given"), "values"),
        (lambda: RemoveOffset(values={"y": 1.0}), "values"),
        (lambda: RemoveOffset(kind="given", values={"y": np.nan}), "values"),
        (lambda: Hampel(half_width=0), "half_width"),
        (lambda: Hampel(sigmas=0), "sigmas"),
        (lambda: Hampel(floor=-1), "floor"),
        (lambda: LowPass(cutoff=0), "cutoff"),
        (lambda: LowPass(cutoff=1, order=0), "order"),
        (lambda: Decimate(factor=1), "factor"),
        (lambda: Resample(sample_time=0), "sample_time"),
        (lambda: ToTime(speed="n", degrees=0, sample_time=1), "degrees"),
        (lambda: ToCrankAngle(speed="n", degrees=-1), "degrees"),
    ],
)
def test_settings_that_make_no_sense(make, field):
    # a word beyond a Literal is stopped by the type check of the tests
    with pytest.raises((SpecError, TypeCheckError)) as error:
        make()
    if isinstance(error.value, JaxnarxError):
        assert error.value.field == field  # type: ignore[attr-defined]


def test_too_little_is_said_record_by_record(data):
    for step, words in (
        (Hampel(half_width=60), "r1 has 110 rows, the window .* 121"),
        (LowPass(cutoff=0.05), "r0 lasts 15 s, less than one period .* 20 s"),
        (Decimate(factor=15), "r1: of 110 samples 8 would be left, at least 10"),
        (Resample(sample_time=1.5), "r1: of 110 samples 8 would be left"),
        (Shift(samples={"NOx": 105}), "r1: of 110 rows 5 would be left"),
    ):
        with pytest.raises(DataError, match=words):
            prepare(data, [step])
