"""The battery finds what it is there for."""

import time

import numpy as np
import pytest
from battery import MEMORY_IS_TOLD, Battery, mutate

from jaxnarx.errors import DataFileError


def fails(attempt, **limits) -> str:
    with pytest.raises(AssertionError) as caught:
        Battery(0, 3).run(attempt, **limits)
    return str(caught.value)


def test_own_errors_and_results_are_counted():
    def attempt(rng):
        if rng.random() < 0.5:
            raise DataFileError("a.csv: no")

    ends = Battery(3, 50).run(attempt)
    assert sum(ends.values()) == 50 and set(ends) == {"done", "DataFileError"}
    # a case depends on its number alone, so that one can be run again
    alone = [next(iter(Battery(3, 1, i).run(attempt))) for i in range(50)]
    assert alone.count("done") == ends["done"]


def test_foreign_exceptions_are_listed_with_case_and_place():
    def attempt(rng):
        raise RecursionError("deep")

    said = fails(attempt)
    assert "3 of 3 cases failed with --robustness-seed=0" in said
    assert "--robustness-first=2: RecursionError at test_battery.py" in said


def test_what_hangs_is_stopped_whatever_catches_exceptions():
    def attempt(rng):
        try:
            time.sleep(60)
        except Exception:
            pass

    assert "Hang" in fails(attempt, seconds=0.05)


@pytest.mark.skipif(not MEMORY_IS_TOLD, reason="the system does not tell")
def test_what_takes_memory_for_a_moment_is_found():
    assert "MB, allowed are 50" in fails(lambda rng: np.ones(10**7), megabytes=50)


def test_damages_differ_and_repeat_by_seed():
    raw = bytes(range(200))
    made = [mutate(raw, np.random.default_rng(i), [b"\n", b"NaN"]) for i in range(99)]
    again = [mutate(raw, np.random.default_rng(i), [b"\n", b"NaN"]) for i in range(99)]
    assert made == again and len(set(made)) > 90
    assert min(map(len, made)) < len(raw) < max(map(len, made))
