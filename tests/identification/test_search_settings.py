"""What the verb `identify` refuses before a search begins, and what it hands on."""

import dataclasses

import numpy as np
import pytest
from identify_problems import engine
from search_fakes import FakeSearch

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.identification import identify
from jaxnarx.settings import Identification, Physics

SIGN = Physics(increases_with=["a"])


@pytest.fixture(scope="module")
def data() -> Dataset:
    return engine(1)


@pytest.fixture
def fake(monkeypatch) -> FakeSearch:
    search = FakeSearch()
    monkeypatch.setattr("jaxnarx.identification.verb.search", search)
    return search


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"preset": "fast"}, "preset: there is no 'fast'"),
        ({"budget": 0.0}, "budget must be a positive number of seconds, got 0"),
        ({"budget": float("nan")}, "budget must be"),
        ({"candidates": 0}, "candidates must be at least 1"),
        ({"outputs": ("x",)}, "no output 'x'"),
        ({"physics": {"x": SIGN}}, "physics: there is no output 'x'. Known names: y"),
        ({"physics": {"y": Physics(increases_with=["q"])}}, "y: there is no input 'q'"),
    ],
)
def test_settings_that_make_no_sense(data, fake, options, words):
    with pytest.raises(SpecError, match=words):
        identify(data, **options)
    assert not fake.options


@pytest.mark.parametrize(
    "option",
    [
        {"preset": "best"},
        {"budget": 9.0},
        {"candidates": 2},
        {"folder": "x"},
        {"physics": {"y": SIGN}},
    ],
)
def test_a_method_is_no_search(data, option):
    with pytest.raises(SpecError, match=f"{next(iter(option))} belongs to a search"):
        identify(data, Identification(), **option)


def test_records_for_validation_are_a_group_of_their_own(data, fake, tmp_path):
    fit = identify(data[:2], validation=data[2:], folder=tmp_path, progress=print)
    assert fake.options["groups"] == ["", "", "validation"]
    assert fit.value.output_names == ["y"]
    assert len(fit.stats["leaderboard"]) == len(fake.tried) == 5


def test_a_constant_output_is_told_by_name(data, fake):
    still = [dataclasses.replace(r, y=np.full_like(r.y, 3.0)) for r in data]
    flat = dataclasses.replace(data, records=tuple(still))
    with pytest.raises(DataError, match="'y' is constant"):
        identify(flat)
    assert not fake.options
