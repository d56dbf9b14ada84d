"""Networks with hidden channels: their run, and all that is told and kept of them."""

import csv
import dataclasses

import hidden_problems
import jax
import numpy as np
import pytest
from common import CHANNELS, named
from hidden_problems import FREE, WINDOW, free_run, network, truth

import jaxnarx as jnx
from jaxnarx import design, inverse
from jaxnarx.data import Channel, Channels
from jaxnarx.data.batch import stack_records
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import cost, local_behaviour
from jaxnarx.linear import adapt
from jaxnarx.models import (
    Network,
    combine_outputs,
    drop_outputs,
    load,
    save,
    split_outputs,
)
from jaxnarx.regressors import Variables
from jaxnarx.shell import cli
from jaxnarx.simulation import (
    first_anchor,
    make_drive,
    make_masks,
    match_records,
    predict,
    prepare,
    run,
    run_parts,
    scaled_run,
    simulate,
)

TOP = 0.5
"""A bound of x1 that holds it at times."""


# the run --------------------------------------------------------------------------


@pytest.mark.parametrize("top", [FREE, TOP], ids=["free", "held"])
@pytest.mark.parametrize("kind", ["plain", "scheduled"])
def test_the_free_run_is_the_plain_recursion(kind, top):
    given = truth(kind, top=top)
    for own, every in zip(
        free_run(network(kind, top=top), given), given.computed, strict=True
    ):
        # A few hundred roundings of numbers of the size of ten.
        np.testing.assert_allclose(own, every[1:], atol=1e-12)
        held = np.mean(every[1:, 2] == top)
        assert held == 0 if top == FREE else 0.1 < held < 0.3
        assert np.all(every[1:].std(axis=0) > 0.1)


def test_padding_in_local_models_changes_nothing():
    plain, padded = network(), network(spare_models=1, spare_slots=2)
    for a, b in zip(*(free_run(n, truth()) for n in (plain, padded)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_a_sample_at_a_bound_of_a_hidden_channel_is_limited_for_all_outputs():
    given, net = truth(top=TOP), network(top=TOP)
    run = simulate(net, given.data)
    # The bound acts on a tenth of the samples and more.
    assert run.status_name == "diverged"
    parts = zip(run.value.limited, run.value.hidden, given.computed, strict=True)
    for limited, hidden, every in parts:
        held = every[:, 2] == TOP
        assert held[WINDOW + 1 :].any()
        expected = np.where(np.arange(len(held)) > WINDOW, held, False)
        np.testing.assert_array_equal(limited, expected[:, None] & [[True, True]])
        np.testing.assert_allclose(
            hidden[WINDOW:], every[WINDOW:, 2:], atol=1e-3
        )  # the prior


# channels -------------------------------------------------------------------------


def test_hidden_channels_come_last_and_no_record_is_asked_for_them():
    net = network()
    own = net.channels
    assert own.names == ["a", "b", "y", "w", "x1", "x2"]
    assert own.measured == CHANNELS and net.signals == hidden_problems.OWN
    assert net.computed_names == ["y", "w", "x1", "x2"]
    assert (net.hidden, net.history, net.before) == (2, 1, 1 + WINDOW)
    with pytest.raises(SpecError, match="'x1' is named more than once"):
        Channels(own.inputs, own.outputs, (Channel("x1"), Channel("x1")))
    with pytest.raises(ValueError, match="2 modelled outputs and 1 hidden channels"):
        fewer = Channels(own.inputs, own.outputs, own.hidden[:1])
        dataclasses.replace(net, channels=fewer)


# parts, merged and narrowed -------------------------------------------------------


def part(output: int, **more) -> Network:
    """The network of one output alone."""
    net, at = network(**more), np.array([output, 2, 3])
    return dataclasses.replace(
        net,
        modelled=(output,),
        models=tuple(net.models[k] for k in at),
        lower=net.lower[at],
        upper=net.upper[at],
    )


def told_starts(net: Network):
    """Scaled free runs from the true hidden values, and the samples that are scored."""
    given = truth()
    batch = stack_records(match_records(net, given.data))
    drive, masks = make_drive(net, batch), make_masks(net, batch, net.window)
    measured = np.array(drive.measured)
    for n, every in enumerate(given.computed):
        start = every[masks.start[n] - 1, 2:] / hidden_problems.GAIN[4:]
        measured[n, masks.start[n] - 1, -net.hidden :] = np.tile(start, net.hidden // 2)
    drive = dataclasses.replace(drive, measured=jax.device_put(measured))
    found = run(net, drive, jax.device_put(first_anchor(masks)))
    return np.asarray(found), masks.scored


def test_merged_networks_run_as_their_parts():
    parts = [part(0), part(1)]
    both = combine_outputs(parts)
    assert both.channels.hidden == tuple(Channel(f"x{n}") for n in (1, 2, 3, 4))
    assert both.output_names == ["y", "w"] and both.window == WINDOW
    for name in ("gain", "low", "high", "lower", "upper"):
        known = [np.asarray(getattr(n, name))[-2:] for n in parts]
        found = np.asarray(getattr(both, name))[-4:]
        np.testing.assert_array_equal(found, np.concatenate(known))
    found, scored = told_starts(both)
    for o, net in enumerate(parts):
        alone, counted = told_starts(net)
        own = [o, 2 + 2 * o, 3 + 2 * o]
        np.testing.assert_allclose(found[..., own], alone, atol=1e-9)
        np.testing.assert_array_equal(scored[..., o], counted[..., 0])


def test_what_was_combined_is_split_again_and_runs_the_same():
    parts = [part(1), named("by inputs")]
    whole = combine_outputs(parts)
    assert [len(p.computed) for p in split_outputs(whole)] == [3, 1]
    for one, own in zip(split_outputs(whole), parts, strict=True):
        assert one.network.equations() == own.equations()
    runs = prepare(whole, truth().data)
    apart, together = run_parts(whole, runs), scaled_run(whole, runs)
    counted = np.asarray(runs.scored).any(axis=2)
    ahead = predict(whole, truth().data, 3).value
    for n, one in enumerate(parts):
        alone = predict(one, truth().data, 3).value
        for a, b, s in zip(ahead.outputs, alone.outputs, alone.scored, strict=True):
            rows = np.flatnonzero(s[:, 0])[: len(a)]
            rows = rows[rows >= whole.before + 3]
            np.testing.assert_allclose(a[rows, n], b[rows, 0], atol=1e-6)
    np.testing.assert_allclose(
        np.asarray(apart)[counted], np.asarray(together)[counted], atol=1e-8
    )


def test_merged_takes_the_longest_window_and_parts_without_hidden_channels():
    longer, closed = part(1, window=WINDOW + 8), named("by inputs")
    both = combine_outputs([longer, closed])
    assert (both.hidden, both.window, both.history) == (2, WINDOW + 8, 2)
    run = simulate(both, truth().data).value
    for n, every in enumerate(truth().computed):
        assert np.argmax(run.scored[n][:, 0]) == both.before
        # The starts differ from the true ones by the prior, and that dies out.
        found = run.outputs[n][both.before :, 0]
        np.testing.assert_allclose(found, every[both.before :, 1], atol=1e-4)


def test_a_name_that_is_taken_is_not_given_to_a_hidden_channel():
    net = part(0)
    inputs = (Channel("x1"), Channel("b"))
    channels = Channels(inputs, net.channels.outputs, (Channel("p"), Channel("q")))
    both = combine_outputs([dataclasses.replace(net, channels=channels)])
    assert [c.name for c in both.channels.hidden] == ["x_1", "x_2"]


def test_narrowed_leaves_the_other_output_out_and_keeps_the_run():
    small = drop_outputs(part(1))
    assert small.channels.names == ["a", "b", "w", "x1", "x2"]
    assert small.window == WINDOW
    assert small.equations() == part(1).equations()
    for a, b in zip(told_starts(small), told_starts(part(1)), strict=True):
        np.testing.assert_array_equal(a, b)
    whole = network()
    assert drop_outputs(whole) is whole


def test_ranged_keeps_what_hidden_channels_have_done():
    from jaxnarx.models import set_ranges

    net = network()
    found = set_ranges(net, truth().data)
    for name, count in (("low", 4), ("high", 4), ("lower", 2), ("upper", 2)):
        old, new = (np.asarray(getattr(n, name)) for n in (net, found))
        np.testing.assert_array_equal(new[count:], old[count:])
        assert np.all(new[:count] != old[:count])


# what is told ---------------------------------------------------------------------


def test_print_equations_and_cost_name_hidden_channels():
    net = network()
    text = str(net)
    assert text.startswith("Network at 0.1 s, from 1 samples of history: a, b -> y, w")
    assert "1 (x1[t-1] near -0.2): y[t] = 5 + 4 x1[t-1] + 2 a[t]*x2[t-1]" in text
    assert "x2: 1 local model, held within" in text
    told = [one["text"] for one in net.equations()]
    assert told == [
        "y[t] = 5 + 4 x1[t-1] + 2 a[t]*x2[t-1]",
        "y[t] = 3 + 6 x1[t-1] - 1 x2[t-1]^2",
        "w[t] = 0.4 w[t-1] + 2 x2[t-1] + 1 b[t]*x1[t-1]",
        "x1[t] = 0.2 + 0.7 x1[t-1] + 0.2 a[t] - 0.1 x1[t-1]*x2[t-1]",
        "x2[t] = -0.1 + 0.5 x2[t-1] + 0.9 b[t] + 0.1 a[t]*x1[t-1]",
    ]
    price = cost(net)
    assert set(price.outputs) == {"y", "w", "x1", "x2"}
    # 17 coefficients; centre and width of two local models of y.
    assert price.parameters == 17 + 4


def test_stability_looks_at_hidden_channels_where_they_have_been():
    given = truth()
    found = jnx.stability(network(), given.data).value
    whole, x1 = found.poles[-1], found.poles[3]
    assert whole.output == "network" and (x1.output, x1.model) == ("x1", 1)
    anchors = [every[WINDOW:-1] for every in given.computed]
    x2 = np.concatenate(anchors)[:, 3]
    expected = np.abs(0.7 - 0.1 * x2)
    assert x1.samples == len(expected) and np.ptp(expected) > 0.1
    # Hidden values are estimated from windows of their own, to the prior.
    assert x1.median == pytest.approx(np.median(expected), abs=1e-4)
    assert x1.largest == pytest.approx(expected.max(), abs=1e-3)
    assert found.contracts and found.bound.worst.scheduling["x1[t-1]"] != 0.0


def by_input() -> Network:
    """With the local models of y over a[t], so that a report has maps of regions."""
    net = network()
    y = dataclasses.replace(net.models[0], scheduling=Variables(((0, 0),)))
    return dataclasses.replace(net, models=(y, *net.models[1:]))


@pytest.mark.slow
@pytest.mark.parametrize(
    "net",
    [network(), by_input()],
    ids=["by a state", "by an input"],
)
def test_a_report_of_it_is_written_whole(net, tmp_path):
    data = truth().data
    found = jnx.report(net, {"train": data, "test": data}, horizons=(1,))
    assert not found.beside, "states have no linear model of the same lags"
    assert "hidden states are estimated" in str(found)
    found.to_html(tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "hidden states are estimated" in text and text.rstrip().endswith("</html>")


def test_files_need_no_hidden_columns(tmp_path, capsys):
    net, data = network(), truth().data
    save(net, tmp_path / "m.safetensors")
    names = ["new.csv", "other.csv"]
    for record, name in zip(data, names, strict=True):
        with open(tmp_path / name, "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["time", "a", "b", "y", "w"])
            for t, (u, y) in enumerate(zip(record.u, record.y, strict=True)):
                writer.writerow([0.1 * t, *u, *y])
    out = tmp_path / "out"
    files = [str(tmp_path / name) for name in ("m.safetensors", *names)]
    assert cli.run(["simulate", *files, "--out", str(out)]) == 0
    assert "read a, b, y, w" in capsys.readouterr().out
    for y, name in zip(simulate(net, data).value.outputs, names, strict=True):
        rows = list(csv.DictReader((out / name).read_text().splitlines()))
        told = np.array([float(row["y simulated"]) for row in rows])
        np.testing.assert_allclose(told, y[:, 0], rtol=1e-5)


# files ----------------------------------------------------------------------------


def test_a_network_that_comes_back_runs_the_same_bit_by_bit(tmp_path):
    net = network()
    save(net, tmp_path / "m")
    again = load(tmp_path / "m")
    assert jax.tree.structure(again) == jax.tree.structure(net)
    runs = [simulate(one, truth().data).value for one in (net, again)]
    for a, b in zip(*(r.outputs + r.hidden for r in runs), strict=True):
        np.testing.assert_array_equal(a, b)


# what there is not ----------------------------------------------------------------

REFUSED = {
    "uncertainty": lambda n, d: jnx.uncertainty(n, d),
    "residuals": lambda n, d: jnx.diagnose(n, d),
    "local models": lambda n, d: local_behaviour(n, d),
    "adaptation": lambda n, d: adapt(n, d),
    "design": lambda n, d: design.network_sensitivity(n),
    "inverse": lambda n, d: inverse.invertible(n, d, commands=["a"], targets=["y"]),
    "reach": lambda n, d: inverse.reachable(n, d, commands=["a"], targets=["y"]),
    "cascade": lambda n, d: inverse.cascade(n, n, d),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_would_need_them_measured_is_refused_with_a_sentence(what):
    sentence = "knows no hidden channels, and the model has x1, x2: nobody measures"
    with pytest.raises(SpecError, match=sentence):
        REFUSED[what](network(), truth().data)
