"""Model files: exact round trips, and every kind of damage as a ModelFileError."""

import dataclasses
import json
import os
import pickle
from concurrent.futures import ThreadPoolExecutor

import common
import equinox as eqx
import hidden_problems
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from common import KINDS, PARTS
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Array, Float
from safetensors.numpy import load_file, save_file

from jaxnarx.data import Channel, Channels
from jaxnarx.errors import ModelFileError, SpecError
from jaxnarx.models import (
    AbstractValidity,
    hold_to_range,
    load,
    save,
    set_nan_policy,
    validity,
)
from jaxnarx.models.storage import FORMAT_VERSION, load_about
from jaxnarx.simulation import simulate


@pytest.fixture(autouse=True)
def as_installed():
    """Without the tests' own type checks, which users do not have."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def build(kind: str, **spare):
    names, modelled = KINDS[kind]
    return common.network([PARTS[n] for n in names], modelled, **spare)


@pytest.fixture
def path(tmp_path):
    """A model of two outputs with several local models each."""
    path = tmp_path / "model.safetensors"
    save(build("coupled, by own output", spare_models=1, spare_slots=2), path)
    return path


def contents(path):
    """Tensors and header of a model file."""
    from safetensors import safe_open

    with safe_open(path, framework="numpy") as file:
        header = json.loads(file.metadata()["jaxnarx"])
    del header["sha256"]  # which would refuse every change
    return load_file(path), header


def write(path, tensors, header):
    text = header if isinstance(header, str) else json.dumps(header)
    save_file(tensors, path, metadata={"jaxnarx": text})


def refused(path, *words):
    """Loading fails with one sentence that names the file and holds `words`."""
    with pytest.raises(ModelFileError) as caught:
        load(path)
    text = str(caught.value)
    assert text.startswith(str(path)) and "\n" not in text
    for word in words:
        assert word in text
    assert caught.value.path == path


# round trip -----------------------------------------------------------------------


@pytest.mark.parametrize("spare", [{}, {"spare_models": 2, "spare_slots": 3}])
@pytest.mark.parametrize("kind", KINDS)
def test_a_network_comes_back_bit_by_bit(tmp_path, kind, spare):
    network = build(kind, **spare)
    save(network, tmp_path / "m")
    again = load(tmp_path / "m")
    assert jax.tree.structure(again) == jax.tree.structure(network)
    pairs = zip(jax.tree.leaves(network), jax.tree.leaves(again), strict=True)
    for a, b in pairs:
        assert a.dtype == b.dtype and a.shape == b.shape
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()


def test_limits_come_back_and_need_the_newest_format(tmp_path):
    network = hold_to_range(build("coupled, by own output"), 0.07, outside="hold")
    save(network, tmp_path / "m")
    again = load(tmp_path / "m")
    assert jax.tree.structure(again) == jax.tree.structure(network)
    assert again.hold is not None and again.hold.shape == ()
    assert float(again.hold) == 0.07
    assert contents(tmp_path / "m")[1]["format"] == 5
    save(again, tmp_path / "n")
    assert (tmp_path / "m").read_bytes() == (tmp_path / "n").read_bytes()


def test_files_without_limits_are_those_of_before(tmp_path):
    """An older file has no margin: it is that of the network that is not held."""
    plain = build("by inputs")
    save(plain, tmp_path / "plain")
    save(hold_to_range(plain, outside="hold"), tmp_path / "held")
    tensors, header = contents(tmp_path / "held")
    del tensors[".hold"]
    write(tmp_path / "old", tensors, header | {"format": 1})
    old = load(tmp_path / "old")
    assert old.hold is None and contents(tmp_path / "plain")[1]["format"] == 1
    save(old, tmp_path / "again")
    save(hold_to_range(load(tmp_path / "held"), None), tmp_path / "released")
    for name in ("again", "released"):
        assert (tmp_path / name).read_bytes() == (tmp_path / "plain").read_bytes()


def test_hidden_channels_come_back_with_their_window_in_the_newest_format(tmp_path):
    network = hidden_problems.network(spare_models=1, spare_slots=1)
    named = Channels(
        network.channels.inputs,
        network.channels.outputs,
        (Channel("wall temperature", "K"), Channel("x2")),
    )
    network = hold_to_range(
        dataclasses.replace(network, channels=named), outside="hold"
    )
    save(network, tmp_path / "m")
    again = load(tmp_path / "m")
    assert jax.tree.structure(again) == jax.tree.structure(network)
    assert again.channels == named and again.window == network.window
    assert contents(tmp_path / "m")[1]["format"] == 6
    save(again, tmp_path / "n")
    assert (tmp_path / "m").read_bytes() == (tmp_path / "n").read_bytes()


def test_a_program_of_before_says_that_it_cannot_read_hidden_channels(
    tmp_path, monkeypatch
):
    save(hidden_problems.network(), tmp_path / "m")
    monkeypatch.setattr("jaxnarx.models.storage.FORMAT_VERSION", 5)
    refused(tmp_path / "m", "format 6", "reads formats up to 5", "Update jaxnarx")


HIDDEN_DAMAGE: dict[str, tuple[dict, str]] = {
    "no window": ({"window": None}, "'window' is missing"),
    "negative window": ({"window": -1}, "the window of hidden channels"),
    "window in parts": ({"window": 2.5}, "the window of hidden channels is 2.5"),
    "window as text": ({"window": "12"}, "the window of hidden channels is '12'"),
    "a truth for a window": ({"window": True}, "the window of hidden channels is True"),
    "endless window": ({"window": 10**7}, "the window of hidden channels"),
    "none of them": ({"hidden": []}, "outside the channels"),
    "no list": ({"hidden": None}, "outside the channels"),
    "one too few": ({"hidden": [["x1", ""]]}, "outside the channels"),
    "one too many": ({"hidden": [["p", ""], ["q", ""], ["r", ""]]}, "3 hidden"),
    "a name twice": ({"hidden": [["x1", ""], ["y", ""]]}, "'y' is named more than"),
    "a number": ({"hidden": [["x1", ""], [2, ""]]}, "name or unit is 2"),
    "text": ({"hidden": "x1x2"}, "damaged"),
    "beyond the table": ({"variables": [[6, 1]] * 5}, "outside the channels"),
    "before it is there": ({"variables": [[5, 0]] * 5}, "before it is computed"),
}


@pytest.mark.parametrize("what", HIDDEN_DAMAGE)
def test_damage_to_what_is_said_of_hidden_channels_is_refused(tmp_path, what):
    path, (change, word) = tmp_path / "m", HIDDEN_DAMAGE[what]
    save(hidden_problems.network(), path)
    tensors, header = contents(path)
    header = {k: v for k, v in (header | change).items() if v is not None}
    write(path, tensors, header)
    refused(path, word)


@pytest.mark.parametrize("name", ["gain", "low", "high", "lower", "upper"])
def test_numbers_of_hidden_channels_must_be_there(tmp_path, name):
    path = tmp_path / "m"
    save(hidden_problems.network(), path)
    tensors, header = contents(path)
    tensors[f".{name}"] = tensors[f".{name}"][:-1]
    write(path, tensors, header)
    refused(path, f"{name} has not one entry per")


@pytest.mark.parametrize("bad", [np.array(-0.1), np.array([0.1, 0.1]), np.array(3)])
def test_a_margin_that_is_none_is_refused(tmp_path, bad):
    path = tmp_path / "m"
    save(hold_to_range(build("by inputs"), outside="hold"), path)
    tensors, header = contents(path)
    write(path, tensors | {".hold": bad}, header)
    refused(path, "hold" if bad.dtype.kind == "i" else "margin of limits")


def test_numbers_at_the_ends_of_their_range_survive(tmp_path):
    network = build("one model")
    odd = jnp.asarray([[5e-324, -0.0, 1.7976931348623157e308, 1 / 3]])
    network = eqx.tree_at(lambda n: n.models[0].local.coefficient, network, odd)
    save(network, tmp_path / "m")
    again = load(tmp_path / "m").models[0].local.coefficient
    assert np.asarray(again).tobytes() == np.asarray(odd).tobytes()


def test_a_single_precision_network_stays_one(tmp_path):
    network = jax.tree.map(
        lambda x: x.astype(jnp.float32) if x.dtype == jnp.float64 else x,
        build("one model"),
    )
    save(network, tmp_path / "m")
    assert load(tmp_path / "m").gain.dtype == jnp.float32


def test_the_sample_time_stays_a_number(path):
    assert float(load(path).sample_time) == 0.1


def test_what_is_said_about_a_model_comes_back(tmp_path):
    about = {"command": "jaxnarx identify 'a b.toml'", "names": ["µ", "<b>"]}
    save(build("one model"), tmp_path / "m", about=about)
    assert load_about(tmp_path / "m") == about
    save(build("one model"), tmp_path / "m")
    assert load_about(tmp_path / "m") == {}


def test_odd_channel_names_survive(tmp_path):
    network = build("one model")
    channels = Channels(
        (Channel('"; {}\\', "µg/m³"), Channel("=1+1")), network.channels.outputs
    )
    network = dataclasses.replace(network, channels=channels)
    save(network, tmp_path / "m")
    assert load(tmp_path / "m").channels == channels


# writing --------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_not_written(tmp_path, bad):
    network = build("by inputs")
    network = eqx.tree_at(
        lambda n: n.models[0].local.coefficient,
        network,
        replace_fn=lambda c: c.at[0, 0].set(bad),
    )
    with pytest.raises(ModelFileError, match="not finite"):
        save(network, tmp_path / "m")
    assert not list(tmp_path.iterdir())


def test_a_failed_write_leaves_the_old_file_and_nothing_else(path, monkeypatch):
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(ModelFileError, match="No space") as caught:
        save(build("one model"), path)
    assert caught.value.path == path
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == [path.name]


def test_the_folder_must_exist(tmp_path):
    with pytest.raises(ModelFileError, match="nowhere.*No such file"):
        save(build("one model"), tmp_path / "nowhere" / "m")


def test_savers_to_one_path_leave_one_of_their_models(tmp_path):
    path, models = tmp_path / "m", [build(kind) for kind in ("one model", "by inputs")]
    save(models[0], path)

    def write(network):
        for _ in range(20):
            save(network, path)

    with ThreadPoolExecutor(4) as pool:
        writers = [pool.submit(write, network) for network in models * 2]
        while not all(w.done() for w in writers):
            load(path)
        assert [w.result() for w in writers] == [None] * 4
    assert os.listdir(tmp_path) == ["m"]


# validity functions of one's own --------------------------------------------------


class Halves(AbstractValidity):
    """All of the weight on the first model below one half, on the second above it."""

    trained = ("border",)
    border: Float[Array, ""]

    def __call__(self, z, active):
        low = jnp.where(z[0] < self.border, 1.0, 0.0)
        return jnp.stack([low, 1.0 - low])

    def limits(self, width_band):
        return Halves(self.border - 1.0), Halves(self.border + 1.0)

    def check(self, models, dims):
        if models != 2:
            raise ValueError("halves are two")

    def regions(self, names, offset, span):
        return [{}, {}]


@pytest.fixture
def own():
    """A network of that class; what is registered is forgotten again."""
    part = dataclasses.replace(
        PARTS["inputs"],
        models=PARTS["inputs"].models[:2],
        centre=((0.2, 0.3), (0.5, 0.6)),
        width=((0.3, 0.4), (0.2, 0.5)),
    )
    yield eqx.tree_at(
        lambda n: n.models[0].validity, common.network([part]), Halves(jnp.asarray(0.5))
    )
    validity.VALIDITIES.pop("Halves", None)


def test_validity_that_no_program_could_read_is_not_written(own, tmp_path):
    with pytest.raises(SpecError, match="'Halves' is not registered"):
        save(own, tmp_path / "m")
    assert not list(tmp_path.iterdir())
    vague = eqx.tree_at(lambda n: n.models[0].validity.border, own, 0.5)
    validity.register_validity(Halves)
    with pytest.raises(SpecError, match="border is no array"):
        save(vague, tmp_path / "m")


def test_registered_validity_comes_back(own, tmp_path):
    assert validity.register_validity(Halves) is Halves
    save(own, tmp_path / "m")
    again = load(tmp_path / "m")
    assert eqx.tree_equal(own, again)
    y = simulate(again, common.dataset()).value.outputs
    for a, b in zip(y, simulate(own, common.dataset()).value.outputs, strict=True):
        np.testing.assert_array_equal(a, b)
    # a program without the class says so, and imports nothing that the file names
    del validity.VALIDITIES["Halves"]
    refused(tmp_path / "m", "'Halves'", "register")
    tensors, header = contents(tmp_path / "m")
    header["models"][0]["validity"] = "os.system"
    write(tmp_path / "m", tensors, header)
    refused(tmp_path / "m", "'os.system'", "register")


def test_a_name_belongs_to_one_class(own):
    other = type("Gaussians", (AbstractValidity,), {"__module__": "mine"})
    with pytest.raises(SpecError, match="'Gaussians' already"):
        validity.register_validity(other)
    validity.register_validity(Halves)
    validity.register_validity(Halves)


# files that are no model files ----------------------------------------------------


def test_a_file_cut_anywhere_is_refused(tmp_path):
    whole = tmp_path / "whole"
    save(build("by inputs"), whole)
    data = whole.read_bytes()
    cut = tmp_path / "cut"

    @settings(max_examples=80, deadline=None, database=None, derandomize=True)
    @given(st.integers(0, len(data) - 1))
    def check(size):
        cut.write_bytes(data[:size])
        refused(cut)

    check()


def test_a_file_with_any_byte_changed_is_refused_or_the_same_model(tmp_path):
    whole = tmp_path / "whole"
    network = build("by inputs")
    save(network, whole)
    data, expected = whole.read_bytes(), jax.tree.leaves(network)
    other = tmp_path / "other"

    @settings(max_examples=150, deadline=None, database=None, derandomize=True)
    @given(st.integers(0, len(data) - 1), st.integers(1, 255))
    def check(at, change):
        other.write_bytes(data[:at] + bytes([data[at] ^ change]) + data[at + 1 :])
        try:
            found = load(other)
        except ModelFileError:
            return
        assert found.channels == network.channels
        for a, b in zip(jax.tree.leaves(found), expected, strict=True):
            np.testing.assert_array_equal(a, b)

    check()


def test_a_file_of_before_has_no_digest(tmp_path, path):
    write(tmp_path / "old", *contents(path))
    assert load(tmp_path / "old").channels == load(path).channels


def test_a_network_that_could_not_be_loaded_is_not_written(tmp_path):
    network = build("by inputs")
    mixed = dataclasses.replace(network, gain=network.gain.astype(np.float32))
    with pytest.raises(ModelFileError, match="not written, .* neither all of float64"):
        save(mixed, tmp_path / "m")
    assert not list(tmp_path.iterdir())


JUNK = {
    "empty": b"",
    "zeros": bytes(4096),
    "noise": np.random.default_rng(0).bytes(4096),
    "text": b"speed,load,NOx\n1,2,3\n" * 50,
    "huge header": (2**62).to_bytes(8, "little") + b"{}",
    "deep json": (4000).to_bytes(8, "little") + b"[" * 4000,
    "pickle": pickle.dumps({"network": [1.0, 2.0]}),
}


@pytest.mark.parametrize("kind", JUNK)
def test_junk_is_refused(tmp_path, kind):
    file = tmp_path / "model.safetensors"
    file.write_bytes(JUNK[kind])
    refused(file, "not a model file")


def test_a_pickle_is_never_executed(tmp_path):
    class Trap:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "executed"),))

    file = tmp_path / "model.safetensors"
    file.write_bytes(pickle.dumps(Trap()))
    refused(file, "not a model file")
    np.save(tmp_path / "a.npy", np.array([Trap()], object), allow_pickle=True)
    refused(tmp_path / "a.npy", "not a model file")
    assert not (tmp_path / "executed").exists()


def test_no_file_and_a_folder_are_told_apart(tmp_path):
    refused(tmp_path / "none.safetensors", "no such model file")
    refused(tmp_path, "a folder", "model.safetensors")


def test_a_foreign_safetensors_file_is_refused(tmp_path):
    file = tmp_path / "weights.safetensors"
    save_file({"layer.0": np.zeros(3)}, file)
    refused(file, "no jaxnarx model")


# damaged contents -----------------------------------------------------------------


def test_a_newer_format_names_the_version_that_wrote_it(path):
    tensors, header = contents(path)
    write(path, tensors, header | {"format": FORMAT_VERSION + 1, "jaxnarx": "9.8.7"})
    refused(path, f"format {FORMAT_VERSION + 1}", "9.8.7", "Update jaxnarx")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "{}",
        "null",
        '"format"',
        "[" * 100_000,
        '{"format": "1"}',
        '{"format": true}',
        '{"format": 0}',
        '{"format": ' + "9" * 5000 + "}",
        '{"format": 1}',
    ],
)
def test_a_damaged_header_is_refused(path, text):
    write(path, contents(path)[0], text)
    refused(path)


HEADERS = {
    "no inputs": lambda h: h.pop("inputs"),
    "inputs no list": lambda h: h.update(inputs=5),
    "name no text": lambda h: h.update(inputs=[[1, 2], [3, 4]]),
    "two channels alike": lambda h: h.update(inputs=[["a", ""], ["a", ""]]),
    "one channel less": lambda h: h["inputs"].pop(),
    "unknown output": lambda h: h.update(modelled=[0, 7]),
    "negative output": lambda h: h.update(modelled=[0, -1]),
    "output twice": lambda h: h.update(modelled=[0, 0]),
    "one output": lambda h: h.update(modelled=[0]),
    "endless": lambda h: h.update(modelled=[0, float("inf")]),
    "unknown signal": lambda h: h["variables"].append([9, 1]),
    "negative lag": lambda h: h["variables"].__setitem__(0, [0, -1]),
    "output at lag 0": lambda h: h["variables"].__setitem__(2, [2, 0]),
    "scheduled on itself": lambda h: h["models"][0].update(scheduling=[[0, 1], [2, 0]]),
    "row of three": lambda h: h["variables"].__setitem__(0, [0, 1, 2]),
    "variables no list": lambda h: h.update(variables="abc"),
    "fewer variables": lambda h: h.update(variables=h["variables"][:2]),
    "validity no name": lambda h: h["models"][0].update(validity=["Gaussians"]),
    "lag beyond memory": lambda h: h["variables"].__setitem__(0, [0, 10**30]),
    "model no table": lambda h: h.update(models=["a", "b"]),
    "one model less": lambda h: h["models"].pop(),
    "no models": lambda h: h.pop("models"),
    "scheduling gone": lambda h: h["models"][0].update(scheduling=[]),
}


@pytest.mark.parametrize("damage", HEADERS)
def test_a_tampered_header_is_refused(path, damage):
    tensors, header = contents(path)
    HEADERS[damage](header)
    write(path, tensors, header)
    refused(path, "damaged")


@pytest.mark.parametrize("about", [[1], "text", 5])
def test_words_about_a_model_are_a_table(path, about):
    tensors, header = contents(path)
    write(path, tensors, header | {"about": about})
    load(path)
    with pytest.raises(ModelFileError, match="no table"):
        load_about(path)


LOCAL = ".models[0].local"


def _set(name, at, value):
    def change(tensors):
        tensors[name] = tensors[name].copy()
        tensors[name][at] = value

    return change


def _map(name, function):
    return lambda tensors: tensors.update({name: function(tensors[name])})


TENSORS = {
    "coefficient NaN": _set(f"{LOCAL}.coefficient", (0, 0), np.nan),
    "coefficient inf": _set(f"{LOCAL}.coefficient", (0, 0), np.inf),
    "gain NaN": _set(".gain", 0, np.nan),
    "gain below numbers": _set(".gain", 0, 5e-324),
    "gain complex": _map(".gain", lambda x: x.astype(np.complex64)),
    "gain whole": _map(".gain", lambda x: x.astype(int)),
    "gain of half precision": _map(".gain", lambda x: x.astype(np.float16)),
    "coefficients of single precision": _map(
        f"{LOCAL}.coefficient", lambda x: x.astype(np.float32)
    ),
    "range beyond numbers": lambda t: t.update(
        {".low": t[".low"] * 0 - 1.7e308, ".high": t[".high"] * 0 + 1.7e308}
    ),
    "range the wrong way": _map(".low", lambda x: -2 * x),
    "bound beyond numbers": _set(".upper", 0, 1e308),
    "bounds the wrong way": _map(".upper", lambda x: -2 * x),
    "scheduling range below numbers": _map(".models[0].span", lambda x: x * 1e-323),
    "gain zero": _set(".gain", 0, 0.0),
    "term too far": _set(f"{LOCAL}.factor", (0, 0), 1000),
    "term negative": _set(f"{LOCAL}.factor", (0, 0), -1),
    "slot too far": _set(f"{LOCAL}.index", (0, 0), 1000),
    "slot negative": _set(f"{LOCAL}.index", (0, 0), -1),
    "slots as reals": _map(f"{LOCAL}.index", lambda x: x.astype(float)),
    "mask as reals": _map(f"{LOCAL}.used", lambda x: x.astype(float)),
    "no model active": _map(".models[0].active", np.zeros_like),
    "one model less": _map(".models[0].active", lambda x: x[1:]),
    "slots cut": _map(f"{LOCAL}.coefficient", lambda x: x[:, 1:]),
    "terms flat": _map(f"{LOCAL}.factor", lambda x: x.reshape(-1)),
    "degree 100": _map(f"{LOCAL}.factor", lambda x: np.tile(x, (1, 50))),
    "centres cut": _map(".models[0].validity.centre", lambda x: x[:, 1:]),
    "offset cut": _map(".models[0].offset", lambda x: x[1:]),
    "span zero": _map(".models[0].span", np.zeros_like),
    "gain short": _map(".gain", lambda x: x[1:]),
    "ranges short": _map(".low", lambda x: x[1:]),
    "bounds short": _map(".upper", lambda x: x[1:]),
    "sample time a list": _map(".sample_time", lambda x: x[None]),
    "sample time zero": _map(".sample_time", np.zeros_like),
    "gain gone": lambda t: t.pop(".gain"),
    "coefficients gone": lambda t: t.pop(f"{LOCAL}.coefficient"),
}


@pytest.mark.parametrize("damage", TENSORS)
def test_tampered_tensors_are_refused(path, damage):
    tensors, header = contents(path)
    TENSORS[damage](tensors)
    write(path, tensors, header)
    refused(path, "damaged")


def test_a_type_that_numpy_does_not_have_is_refused(tmp_path):
    head = json.dumps(
        {
            "__metadata__": {"jaxnarx": "{}"},
            "a": {"dtype": "F8_E4M3", "shape": [4], "data_offsets": [0, 4]},
        }
    ).encode()
    file = tmp_path / "model.safetensors"
    file.write_bytes(len(head).to_bytes(8, "little") + head + bytes(4))
    refused(file)


@pytest.mark.parametrize("policy", [("nan", None), ("hold", 2.0), ("nan", 0.4)])
def test_what_missing_inputs_do_comes_back_in_the_newest_format(tmp_path, policy):
    network = set_nan_policy(build("coupled"), policy[0], invalid_after=policy[1])
    save(network, tmp_path / "m")
    again = load(tmp_path / "m")
    assert (again.nan, again.invalid_after) == (network.nan, network.invalid_after)
    assert contents(tmp_path / "m")[1]["format"] == 10


def test_inputs_of_an_older_model_are_held(tmp_path):
    save(build("coupled"), tmp_path / "m")
    assert "nan" not in contents(tmp_path / "m")[1]
    again = load(tmp_path / "m")
    assert again.nan == "hold" and again.invalid_after is None


@pytest.mark.parametrize(
    "damage",
    [{"nan": "guess"}, {"nan": 1}, {"invalid_after": 0}, {"invalid_after": 1.5}],
)
def test_an_unknown_policy_of_missing_inputs_is_refused(tmp_path, damage):
    save(build("coupled"), tmp_path / "m")
    tensors, header = contents(tmp_path / "m")
    write(tmp_path / "m", tensors, header | {"format": 10} | damage)
    refused(tmp_path / "m", "damaged")
