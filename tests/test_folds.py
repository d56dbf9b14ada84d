"""Models run on folds of blocks: what they start from and what is scored, by the loops.

The records have two inputs that do not repeat each other, so that both are cut.
"""

from functools import cache

import common
import numpy as np
import oracles
import pytest
from common import Y

from jaxnarx.data import Dataset, Fold, Groups, groups
from jaxnarx.errors import SpecError
from jaxnarx.inverse import inverse_data
from jaxnarx.regressors import polynomial_pool
from jaxnarx.regressors.rows import regression_rows
from jaxnarx.selection import select
from jaxnarx.settings import ForwardOLS
from jaxnarx.simulation import predict, simulate
from jaxnarx.sweep import Fleet

GAP, FOLDS = 4, 3
ROUNDING = 1e-10


@cache
def data() -> Dataset:
    return common.dataset((60, 52))


@cache
def found() -> Groups:
    made = groups(data(), folds=FOLDS, gap=GAP)
    assert not made.whole
    return made


@cache
def fold(g: int) -> Fold:
    return found().fold(data(), g)


def rows(n: int) -> np.ndarray:
    return common.rows_of(data(), n)


@pytest.mark.parametrize("g", range(FOLDS))
@pytest.mark.parametrize("kind", ["coupled", "by inputs"])
def test_a_run_goes_from_the_measured_start_and_is_scored_on_the_block(kind, g):
    net = common.named(kind)
    value = simulate(net, fold(g).left).value
    for n in range(2):
        plain = oracles.free_run(rows(n), common.to_oracle(net))
        np.testing.assert_allclose(value[n], plain.outputs, rtol=0, atol=ROUNDING)
        own = plain.usable & (found().labels[n] == g)
        assert own.sum() > 10
        for scored in value.scored[n].T:
            np.testing.assert_array_equal(scored, own)


def test_predictions_of_a_block_start_from_measurements_before_it():
    net, g, k = common.named("coupled"), 1, 3
    value = predict(net, fold(g).left, k).value
    for n in range(2):
        plain = oracles.k_step(rows(n), common.to_oracle(net), k)
        np.testing.assert_allclose(value[n], plain.outputs, rtol=0, atol=ROUNDING)
        np.testing.assert_array_equal(value.scored[n][:, 0], found().labels[n] == g)


@pytest.mark.parametrize("g", range(FOLDS))
def test_training_runs_go_through_the_block_without_looking_at_it(g):
    net = common.named("coupled")
    value = simulate(net, fold(g).train).value
    for n in range(2):
        out = found().held_out_samples(g)[n]
        # A block at the beginning leaves a start behind it, no other changes the run.
        first = int(np.argmin(out)) if out[0] else 0
        plain = oracles.free_run(rows(n)[first:], common.to_oracle(net))
        np.testing.assert_allclose(
            value[n][first + net.history :],
            plain.outputs[net.history :],
            rtol=0,
            atol=ROUNDING,
        )
        usable = np.pad(plain.usable, (first, 0))
        for scored in value.scored[n].T:
            np.testing.assert_array_equal(scored, usable & ~out)


def test_what_is_left_out_changes_nothing_that_is_trained():
    g = 1
    spoilt = [rows(n).copy() for n in range(2)]
    for n, r in enumerate(spoilt):
        r[found().held_out_samples(g)[n], Y:] = 1e3
    other = found().fold(common.from_rows(spoilt), g)
    pool = polynomial_pool(
        data().channels, input_lags=(0, 1), output_lags=(1, 2), degree=1
    )
    one, two = (
        select(pool, part, ForwardOLS(max_terms=4)).value
        for part in (fold(g).train, other.train)
    )
    np.testing.assert_array_equal(one.index, two.index)
    np.testing.assert_array_equal(one.coefficient, two.coefficient)


def test_rows_of_regression_keep_clear_of_the_block():
    pool = polynomial_pool(
        data().channels, input_lags=(0, 1), output_lags=(1, 2), degree=1
    )
    variables = pool.variables
    history = 2
    made = {
        side: regression_rows(part, variables, (0,), history=history, exact=True)
        for side, part in (("train", fold(1).train), ("left", fold(1).left))
    }
    length = made["train"].batch.valid.shape[1]
    for n in range(2):
        out, own = found().held_out_samples(1)[n], found().labels[n] == 1
        want: dict[str, list[int]] = {"train": [], "left": []}
        for t in range(history, len(out)):
            if not out[t - history : t + 1].any():
                want["train"].append(t)
            if own[t]:
                want["left"].append(t)
        for side, expected in want.items():
            at = made[side].at - n * length
            assert at[(at >= 0) & (at < length)].tolist() == expected


def test_what_is_not_scored_stays_so_where_records_are_changed():
    part = fold(1).left
    swapped = inverse_data(part, commands=["a"], targets=["y"], lead=2)
    for record, before in zip(swapped, part, strict=True):
        assert before.scored is not None
        np.testing.assert_array_equal(record.scored, before.scored[:-2])
    with pytest.raises(SpecError, match="a fleet takes whole records"):
        Fleet.from_datasets({"one": part}, train=slice(None))
    assert len(Fleet.from_datasets({"one": fold(1).train}, train=slice(None))) == 1
