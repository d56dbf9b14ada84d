"""Gains at rest that change sign or jump, on equations that say where."""

import dataclasses

import common
import jax
import numpy as np
import pytest
from common import A, B, Y
from test_verdict import FINE, made

import jaxnarx as jnx
from jaxnarx.engines import Vct, records
from jaxnarx.evaluation import check_gains, longest_time_constants
from jaxnarx.evaluation.gain_signs import GainFinding
from jaxnarx.evaluation.physics_checks import section_of_physics
from jaxnarx.identification import Physics
from jaxnarx.models import set_bounds
from jaxnarx.regressors import LowPass, Variables

VARIABLES = ((A, 0), (B, 1), (Y, 1))
LOW, HIGH = np.array([-4.0, -1.0, -9.0, -1.0]), np.array([4.0, 1.0, 9.0, 1.0])


def network(*terms, **part):
    """y(t) = .5 y(t-1) + terms of [1, a, b, y] in scaled signals."""
    models = part.pop("models", None) or [[((0, 3), 0.5), *terms]]
    net = common.network([common.Part(models, **part)], variables=VARIABLES)
    low, high = jax.device_put((LOW, HIGH))
    return dataclasses.replace(net, low=low, high=high)


data = common.dataset((300, 200))


def test_a_linear_model_has_one_sign():
    assert check_gains(network(((0, 1), 0.4), ((0, 2), -0.2)), data) == ()


def test_a_gain_that_another_input_turns_is_told_with_its_share():
    """The gain of a is proportional to .2 + b / .5, negative where b < -.1."""
    net = network(((0, 1), 0.2), ((1, 2), 1.0))
    (found,) = [f for f in check_gains(net, data) if f.over == "a"]
    assert (found.kind, found.output) == ("sign", "y") and 0.2 < found.share <= 0.5
    text = str(found)
    assert "the gain of y by a changes sign: more a, " in text and "is that so?" in text
    assert f"in {found.share:.0%} of the domain, at a " in text


def test_a_gain_that_turns_at_a_maximum_is_told_where():
    """y at rest = 2 a - a^2 / 4 by scaled a: it falls from a = 2 V on."""
    net = network(((0, 1), 0.5), ((1, 1), -0.25))
    (found,) = check_gains(net, data)
    assert not found.rises and found.low > 1.7 and found.unit == "V"


def test_a_report_counts_gains_with_another_sign_than_asked():
    """The gain of a is negative where b < -.1; that of b is positive where a > 0."""
    net = network(((0, 1), 0.2), ((1, 2), 1.0))
    bare = {"stability": False, "diagnostics": False, "horizons": (1,)}
    known = {"y": Physics(increases_with=["a"])}
    told = jnx.report(net, data, physics=known, **bare)
    section = told.sections["physics"]
    ((name, asked, wrong, gains),) = section.rows
    assert (name, asked) == ("y", str(known["y"]))
    assert isinstance(wrong, int) and isinstance(gains, int) and 0 < wrong < gains
    assert section.marked == ((0, 2),)
    assert f"{wrong} of {gains} gains of y at rest" in section.sentences[0]
    assert section.title in str(told)
    right = network(((0, 1), 0.4), ((0, 2), -0.2))
    section = jnx.report(right, data, physics=known, **bare).sections["physics"]
    assert section.sentences == ("Nothing contradicts what physics asks.",)
    assert "physics" not in jnx.report(net, data, **bare).sections


def test_what_does_not_come_to_rest_says_nothing():
    models = [[((0, 3), 1.2), ((0, 1), 0.5), ((1, 1), -0.25)]]
    restless = network(models=models)
    assert check_gains(restless, data) == ()
    section = section_of_physics(restless, data, {"y": Physics(increases_with=["a"])})
    assert section is not None and "Of y no gain is known here" in str(section)


def test_time_constants_are_those_of_poles_and_filters():
    """A pole of .5, one of .9 or none where b turns it, and the slower of both."""
    net = network(((0, 1), 0.4), ((0, 2), -0.2))
    time = float(net.sample_time)
    assert longest_time_constants(net, data)["y"] == pytest.approx(time / np.log(2))
    bent = network(models=[[((0, 3), 0.5), ((2, 3), 0.2), ((0, 1), 0.4)]])
    rows = np.concatenate([r.signals for r in data])
    b = rows[np.linspace(0, len(rows) - 1, 24).astype(int), 1]
    pole = np.abs(0.5 + 0.2 * b / float(bent.gain[1])).max()
    found = longest_time_constants(bent, data)["y"]
    assert found == pytest.approx(-time / np.log(pole))
    bare = common.network([common.Part([[((1,), 0.5)]])], variables=((A, 3),))
    assert longest_time_constants(bare, data)["y"] == 0.0
    fast = dataclasses.replace(bare, variables=Variables.of([(A, 0, LowPass(20.0))]))
    assert longest_time_constants(fast, data)["y"] == pytest.approx(20.0)
    wild = network(models=[[((0, 3), 1.2), ((0, 1), 0.5)]])
    assert longest_time_constants(wild, data)["y"] == np.inf
    drifts = set_bounds(network(models=[[((0, 3), 0.999), ((0, 1), 0.4)]]))
    found = longest_time_constants(drifts, data)["y"]
    assert found == pytest.approx(-time / np.log(0.999))
    rows = [
        dataclasses.replace(r, valid=r.valid & (np.arange(r.valid.shape[1]) < 2))
        for r in data
    ]
    unseen = dataclasses.replace(data, records=tuple(rows))
    assert longest_time_constants(drifts, unseen)["y"] == pytest.approx(found)
    slow = Physics(longest_time_constant=10.0)
    section = section_of_physics(fast, data, {"y": slow})
    assert section is not None and section.marked == ((0, 4),)
    assert "of y is 20 s, longer than physics allows" in section.sentences[0]
    assert section.rows[0][:2] == ("y", "is no slower than 10 s")


def test_a_jump_is_told():
    """Two constants with a sharp border at a = 0.3 V."""
    steps = [[((0, 0), 0.4)], [((0, 0), -0.4)]]
    net = network(
        models=steps,
        scheduling=((A, 0),),
        offset=(-4.0,),
        span=(8.0,),
        centre=((0.4375,), (0.6375,)),
        width=((0.02,), (0.02,)),
    )
    found = check_gains(net, data)
    assert [f.kind for f in found] == ["jump"] and not found[0].rises
    assert "y at rest falls suddenly with a" in str(found[0])
    assert -0.2 < found[0].low <= found[0].high < 0.8


def test_points_of_a_domain_alone_count_and_nothing_comes_of_nothing():
    net = network(((0, 1), 0.5), ((1, 1), -0.25))
    inside = common.from_rows([np.clip(common.signals(200), -0.5, 0.5)])
    known = jnx.confidence.fit_domain(net, inside)
    assert check_gains(known, data) == () != check_gains(net, data)
    far = common.from_rows([common.signals(60) + 100.0])
    assert check_gains(net, far) == ()
    blind = common.network([common.Part([[((1,), 0.3)]])], variables=((Y, 1),))
    assert check_gains(blind, data) == ()


def test_the_verdict_remarks_on_them_and_stays():
    gains = tuple(
        GainFinding("sign", "T", f"u{n}", "deg", 0.1 * n, 1.0, 2.0, False)
        for n in range(1, 6)
    )
    report = made(*FINE, gains=gains)
    assert report.verdict.level == "good"
    assert report.verdict.remarks == (
        *map(str, gains[:1:-1]),
        "2 more gains change sign or jump",
    )
    assert "more u5, less T in 50% of the domain" in report.summary.also[0]


def test_diagnose_and_report_tell_them():
    net = network(((0, 1), 0.5), ((1, 1), -0.25))
    rng = np.random.default_rng(0)
    run = jnx.simulate(net, data).value
    own = tuple(
        dataclasses.replace(r, y=np.c_[y + 0.1 * rng.normal(size=y.shape), r.y[:, 1]])
        for r, y in zip(data, run.outputs, strict=True)
    )
    clean = dataclasses.replace(data, records=own)
    found = jnx.diagnose(net, clean).value
    (gain,) = found.gains
    assert str(gain) in str(found) and found.to_dict()["gains"][0]["kind"] == "sign"
    report = jnx.report(net, clean, horizons=(1,), stability=False)
    assert report.gains == found.gains and str(gain) in report.verdict.remarks


@pytest.mark.slow
def test_a_polynomial_of_a_virtual_engine_turns_round_and_a_linear_one_does_not():
    """A poor model of NOx (NRMSE 0.3) falls with the throttle at some points."""
    bed = records(Vct(), jax.random.key(2), [3000], outputs=["NOx"])

    def gains(degree, terms):
        lags = (1, 2, 3, 5, 8)
        pool = jnx.polynomial_pool(
            bed.channels, input_lags=lags, output_lags=(1, 2), degree=degree
        )
        chosen = jnx.select(pool, bed, jnx.ForwardOLS(max_terms=terms)).value
        return check_gains(jnx.grow(chosen, bed, jnx.Global()).value, bed)

    (found,) = [f for f in gains(2, 20) if f.over == "throttle"]
    assert found.kind == "sign" and not found.rises and found.share < 0.3
    assert gains(1, 8) == ()
