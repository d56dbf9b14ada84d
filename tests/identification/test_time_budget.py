"""Time of a search by output, played with a clock of its own."""

import pytest

from jaxnarx.identification.time_budget import TimeBudget


@pytest.mark.parametrize(
    ("outputs", "workers"), [(1, 1), (3, 2), (4, 1), (2, 2), (9, 2)]
)
def test_every_output_has_its_share_and_none_begins_after_the_end(outputs, workers):
    """Each uses all that it is given."""
    shares = TimeBudget(1120.0, outputs, workers)
    ends: list[float] = []
    for n in range(outputs):
        now = 1000.0 if n < workers else sorted(ends)[n - workers]
        assert now < 1120.0
        ends.append(shares.begin(str(n), now))
        assert ends[-1] - now >= 120.0 / -(-outputs // workers) - 1e-9
    assert max(ends) <= 1120.0 + 1e-9


def test_what_one_leaves_the_others_have():
    shares = TimeBudget(100.0, 2, 1)
    assert shares.begin("a", 0.0) == 50.0
    shares.finish("a", 10.0)
    assert shares.begin("b", 10.0) == 100.0


def test_time_left_is_told_by_what_outputs_took():
    shares = TimeBudget(1000.0, 4, 2)
    shares.begin("a", 0.0)
    shares.begin("b", 0.0)
    assert shares.seconds_left(5.0) is None
    shares.finish("a", 10.0)
    shares.begin("c", 10.0)
    # b is over its time, c needs all of it, and one waits: 20 s of work for two.
    assert shares.seconds_left(10.0) == pytest.approx(10.0)
    shares.finish("b", 30.0)
    assert shares.seconds_left(30.0) == pytest.approx((0.0 + 20.0) / 2)
