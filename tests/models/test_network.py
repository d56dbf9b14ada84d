"""Validity functions, local models, equations, and the two paths of a free run."""

import re
from functools import cache

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import oracles
import pytest
from common import KINDS, PARTS

from jaxnarx.arrays.recurrence import free_run
from jaxnarx.data.batch import stack_records
from jaxnarx.models import (
    Gaussians,
    Network,
    collapse,
    collapses,
    depth,
    fed_back_variables,
    general_step,
    respond,
    run_record,
)
from jaxnarx.simulation import make_drive

# Rounding of sums of some ten products of order one.
ROUNDING = 1e-13


# validity functions ---------------------------------------------------------------


def array(values) -> jax.Array:
    """Of a list or of numpy, without a program for its shape."""
    return jax.device_put(np.asarray(values))


def gaussians(centre, width) -> Gaussians:
    return Gaussians(array(centre), array(np.log(width)))


def random_partition(models=4, dims=2, seed=0):
    rng = np.random.default_rng(seed)
    centre = rng.uniform(size=(models, dims))
    return centre, rng.uniform(0.05, 0.6, size=(models, dims))


weights = eqx.filter_jit(lambda f, z, active: f(z, active))


def test_weights_are_the_normalised_gaussians():
    centre, width = random_partition()
    z = np.random.default_rng(1).uniform(-0.5, 1.5, size=(50, 2))
    phi = weights(gaussians(centre, width), array(z.T), array(np.ones(4, bool)))
    expected = oracles.validity(z, centre, width).T
    np.testing.assert_allclose(phi, expected, rtol=1e-11, atol=1e-300)


@pytest.mark.parametrize("distance", [1.0, 1e3, 1e100])
def test_weights_sum_to_one_however_far_away(distance):
    centre, width = random_partition(seed=2)
    z = distance * np.random.default_rng(2).normal(size=(2, 50))
    phi = weights(gaussians(centre, width), array(z), array(np.ones(4, bool)))
    np.testing.assert_allclose(np.sum(phi, axis=0), 1.0, rtol=1e-15 * 4)
    assert np.all(np.asarray(phi) >= 0)


def test_inactive_models_weigh_nothing_and_the_others_share():
    centre, width = random_partition(seed=3)
    z = array(np.random.default_rng(3).uniform(size=(2, 50)))
    active = np.array([True, False, True, False])
    phi = weights(gaussians(centre, width), z, array(active))
    np.testing.assert_array_equal(phi[~active], 0.0)
    alone = weights(
        gaussians(centre[active], width[active]), z, array(np.ones(2, bool))
    )
    np.testing.assert_array_equal(phi[active], alone)


def test_unequal_widths_reactivate_far_away():
    # Figures of DESIGN section 5, printed to six decimals.
    f = gaussians([[0.2], [0.5]], [[0.2], [0.05]])
    phi = weights(f, array([[0.2, 0.5, 0.9]]), array(np.ones(2, bool)))
    np.testing.assert_allclose(phi[0], [1.0, 0.245085, 1.0], atol=1e-6)


def test_one_model_without_scheduling_is_valid_everywhere():
    f = Gaussians(array(np.zeros((1, 0))), array(np.zeros((1, 0))))
    phi = f(array(np.zeros((0, 7))), array(np.ones(1, bool)))
    np.testing.assert_array_equal(phi, np.ones((1, 7)))


def test_gradients_are_finite_far_away_and_zero_for_inactive_models():
    centre, width = random_partition(seed=4)
    active = jnp.asarray([True, True, True, False])
    z = jnp.asarray([[0.3, 1e3], [0.6, -1e3]])

    def total(f, z):
        return jnp.sum(f(z, active) * jnp.arange(8.0).reshape(4, 2))

    by_f, by_z = jax.jit(jax.grad(total, argnums=(0, 1)))(gaussians(centre, width), z)
    for leaf in (by_f.centre, by_f.log_width, by_z):
        assert np.all(np.isfinite(leaf))
    np.testing.assert_array_equal(by_f.centre[3], 0.0)
    np.testing.assert_array_equal(by_f.log_width[3], 0.0)
    assert np.any(np.asarray(by_f.centre[:3]) != 0.0)


def test_limits_hold_the_centre_in_the_range_and_the_width_in_its_band():
    centre, width = random_partition(seed=5)
    low, high = gaussians(centre, width).limits((0.5, 3.0))
    np.testing.assert_array_equal(low.centre, np.zeros_like(centre))
    np.testing.assert_array_equal(high.centre, np.ones_like(centre))
    np.testing.assert_allclose(np.exp(low.log_width), 0.5 * width, rtol=1e-14)
    np.testing.assert_allclose(np.exp(high.log_width), 3.0 * width, rtol=1e-14)


# one network at many samples ------------------------------------------------------


@cache
def data():
    return common.dataset()


def design(net: Network, record: int = 0):
    """Scaled lagged variables behind a one, and physical scheduling variables."""
    rows = common.rows_of(data(), record)
    x, _ = oracles.lagged(rows / common.GAIN, net.variables.rows)
    v = np.concatenate([np.ones((1, len(x))), x.T])
    z = tuple(oracles.lagged(rows, m.scheduling.rows)[0].T for m in net.models)
    return jnp.asarray(v), tuple(jnp.asarray(a) for a in z)


respond_jit = eqx.filter_jit(respond)


def one_step(net: Network) -> np.ndarray:
    """Physical outputs of record 0 from measured lags, (outputs, time)."""
    gain = np.asarray(net.gain)[list(net.signals)]
    return np.asarray(respond_jit(net, *design(net))) * gain[:, None]


def evaluated(net: Network) -> np.ndarray:
    """The same by the oracle; zero where the history is not complete."""
    rows, plain = common.rows_of(data(), 0), common.to_oracle(net)
    y = np.zeros((len(net.models), len(rows)))
    for o, output in enumerate(plain.outputs):
        for t in range(net.history, len(rows)):
            y[o, t] = oracles.evaluate_output(output, rows, plain.gain, t)[0]
    return y


@pytest.mark.parametrize("kind", KINDS)
def test_a_network_equals_its_oracle(kind):
    net = common.named(kind)
    assert net.history == common.to_oracle(net).max_lag
    after = slice(net.history, None)
    np.testing.assert_allclose(
        one_step(net)[:, after], evaluated(net)[:, after], rtol=0, atol=1e-11
    )


def test_padding_has_no_effect():
    plain = common.named("by inputs")
    padded = common.named("by inputs", spare_models=2, spare_slots=3)
    np.testing.assert_allclose(
        one_step(padded), one_step(plain), rtol=0, atol=10 * ROUNDING
    )

    @eqx.filter_grad
    def gradient(net):
        return jnp.sum(respond(net, *design(net)) ** 2)

    model = eqx.filter_jit(gradient)(padded).models[0]
    for leaf in jax.tree.leaves(eqx.filter(model, eqx.is_inexact_array)):
        assert np.all(np.isfinite(leaf))
    used = np.asarray(padded.models[0].local.used) & (np.arange(5) < 3)[:, None]
    np.testing.assert_array_equal(model.local.coefficient[~used], 0.0)
    assert np.all(np.asarray(model.local.coefficient)[used] != 0.0)
    np.testing.assert_array_equal(model.validity.centre[3:], 0.0)


def test_the_order_of_local_models_does_not_matter():
    net = common.named("by inputs")
    order = np.array([2, 0, 1])

    def permuted(model):
        return eqx.tree_at(
            lambda m: [
                m.validity.centre,
                m.validity.log_width,
                m.local.index,
                m.local.used,
                m.local.coefficient,
            ],
            model,
            replace_fn=lambda leaf: leaf[order],
        )

    other = eqx.tree_at(lambda n: n.models[0], net, replace_fn=permuted)
    np.testing.assert_allclose(one_step(other), one_step(net), rtol=0, atol=1e-11)


def test_a_term_listed_twice_in_a_model_adds_up():
    net = common.named("one model")
    local = net.models[0].local
    # Slot 3 repeats slot 0's term.
    twice = eqx.tree_at(
        lambda m: m.index, local, local.index.at[0, 3].set(local.index[0, 0])
    )
    summed = eqx.tree_at(
        lambda m: m.coefficient,
        local,
        local.coefficient.at[0, 0].add(local.coefficient[0, 3]).at[0, 3].set(0.0),
    )
    outputs = [
        one_step(eqx.tree_at(lambda n: n.models[0].local, net, m))
        for m in (twice, summed)
    ]
    np.testing.assert_allclose(outputs[0], outputs[1], rtol=0, atol=1e-12)


def test_as_many_models_as_outputs():
    with pytest.raises(
        ValueError, match="2 modelled outputs and 0 hidden channels but 1 models"
    ):
        common.network([PARTS["one"]], (0, 1))


# equations ------------------------------------------------------------------------

FACTOR = re.compile(r"(?P<name>\w+)\[t(-(?P<lag>\d+))?\](\^(?P<power>\d+))?")


def product(text: str, rows: np.ndarray) -> np.ndarray:
    """Value of a printed term at every sample; wraps around before the history."""
    out = np.ones(len(rows))
    for part in text.split("*") if text != "1" else ():
        match = FACTOR.fullmatch(part)
        assert match, part
        signal = common.CHANNELS.names.index(match["name"])
        x = np.roll(rows[:, signal], int(match["lag"] or 0))
        out *= x ** int(match["power"] or 1)
    return out


@pytest.mark.parametrize("kind", KINDS)
def test_equations_in_physical_units_evaluate_to_the_network(kind):
    net = common.named(kind, spare_models=1, spare_slots=2)
    rows, after = common.rows_of(data(), 0), slice(net.history, None)
    equations = net.equations()
    total = np.zeros((len(net.models), len(rows)))
    for o, name in enumerate(net.output_names):
        own = [e for e in equations if e["output"] == name]
        assert [e["model"] for e in own] == list(range(1, len(own) + 1))
        local = np.array(
            [sum(c * product(text, rows) for text, c in e["terms"]) for e in own]
        )
        if len(own) == 1:
            total[o] = local[0]
            continue
        # Regions are physical too: no scaling is needed for the weights.
        table = list(own[0]["region"])
        z = np.column_stack([product(variable, rows) for variable in table])
        centre, width = (
            np.array([[e["region"][d][k] for d in table] for e in own])
            for k in ("centre", "width")
        )
        total[o] = np.sum(oracles.validity(z, centre, width).T * local, axis=0)
    assert len(equations) == sum(len(p.models) for p in parts_of(kind))
    np.testing.assert_allclose(
        total[:, after], one_step(net)[:, after], rtol=0, atol=1e-11
    )


def parts_of(kind):
    return [PARTS[name] for name in KINDS[kind][0]]


def test_an_equation_reads_as_its_terms():
    (entry,) = common.named("one model").equations()
    # y/10 = 0.1 + 0.5 a/2 + 0.6 y/10 - 0.2 (b/0.5)(y/10), times 10.
    assert entry["text"] == ("y[t] = 1 + 2.5 a[t] + 0.6 y[t-1] - 0.4 b[t-1]*y[t-1]")
    assert entry["region"] == {}
    (latex,) = common.named("one model").equations(style="latex")
    assert latex["latex"].startswith(r"\mathrm{y}(t) = 1 + 2.5\,\mathrm{a}(t)")


# free run: collapsed, general, plain ----------------------------------------------


def test_only_scheduling_on_outputs_keeps_the_run_from_collapsing():
    expected = {"by own output": False, "coupled, by own output": False}
    for kind in KINDS:
        assert collapses(common.named(kind)) == expected.get(kind, True), kind


def test_many_feedback_monomials_do_not_collapse():
    # Six fed-back variables at degree 4 make C(10, 4) = 210 monomials.
    lags = tuple((common.Y, d) for d in range(1, 7))
    part = common.Part([[((1, 2, 3, 6), 0.1)]])
    assert not collapses(common.network([part], variables=lags))
    assert collapses(common.network([part], variables=lags[:4] + ((common.A, 1),) * 2))


def test_what_is_fed_back():
    net = common.named("coupled")
    assert fed_back_variables(net.variables, net.signals) == [
        (2, 0, 0),
        (3, 0, 1),
        (4, 1, 0),
    ]
    assert depth(net) == 2
    assert (
        depth(common.network([common.Part([[((1,), 1.0)]])], variables=((0, 3),))) == 1
    )


@cache
def drive(kind: str):
    return make_drive(common.named(kind), stack_records(data()))


def record_args(kind: str, n: int = 0):
    d = drive(kind)
    return d.v[n], tuple(x[n] for x in d.x), d.measured[n]


def anchor(net: Network):
    return jnp.arange(common.TIME) == net.history


@eqx.filter_jit
def by_collapse(net, v, x, measured, anchor):
    return run_record(net, v, x, measured, anchor)


@eqx.filter_jit
def by_general_step(net, v, x, measured, anchor):
    return free_run(
        general_step(net),
        eqx.filter(net, eqx.is_array),
        (v.T, tuple(x_o.T for x_o in x)),
        measured,
        anchor,
        net.lower,
        net.upper,
        depth=depth(net),
    )


@pytest.mark.parametrize("bound", [50.0, 0.25], ids=["free", "limited"])
@pytest.mark.parametrize("kind", KINDS)
def test_every_path_is_the_plain_free_run(kind, bound):
    net = common.named(kind, bound=bound)
    gain = np.asarray(net.gain)[list(net.signals)]
    plain = oracles.free_run(common.rows_of(data(), 0), common.to_oracle(net))
    limited = plain.limited[plain.usable].mean()
    assert (limited > 0.02) == (bound < 1)
    paths = [by_collapse, by_general_step] if collapses(net) else [by_collapse]
    for path in paths:
        y = np.asarray(path(net, *record_args(kind), anchor(net))) * gain
        # Sixty steps of a stable recursion in physical units of order ten.
        np.testing.assert_allclose(
            y[:60][plain.usable], plain.outputs[plain.usable], rtol=0, atol=1e-10
        )


def test_the_collapsed_drive_holds_no_measured_output():
    net = common.named("coupled")
    v, x, _ = record_args("coupled")
    rows = [row + 1 for row, _, _ in fed_back_variables(net.variables, net.signals)]
    spoilt = v.at[np.array(rows)].set(1e6)
    compiled = eqx.filter_jit(collapse)
    np.testing.assert_array_equal(compiled(net, v, x), compiled(net, spoilt, x))


def test_padding_leaves_the_free_run_alone():
    args = record_args("by inputs")
    net = common.named("by inputs")
    padded = common.named("by inputs", spare_models=2, spare_slots=3)
    np.testing.assert_allclose(
        by_collapse(padded, *args, anchor(net)),
        by_collapse(net, *args, anchor(net)),
        rtol=0,
        atol=ROUNDING,
    )
