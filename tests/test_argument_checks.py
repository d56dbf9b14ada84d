"""Wrong objects given to verbs: every one is a SpecError, before any work."""

import inspect
import pickle
from functools import cache
from pathlib import Path
from typing import Any

import common
import equinox as eqx
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx.argument_checks import guard_arguments
from jaxnarx.errors import JaxnarxError, SpecError

ROOMS = {
    "evaluation": "cost pareto",
    "partition": "switch",
    "regressors": "kautz_bank laguerre_bank low_pass_bank orthonormal_bank "
    "time_constants",
    "selection": "choose coefficient_table",
} | dict.fromkeys(("design", "fleet", "inverse", "linear", "sweep"), "")
"""Verbs that a room offers; none are named where all its functions are."""
INNER = {
    f"design.{name}"
    for name in ("asked_samples", "limits_for", "make_view", "plan_by", "rest_run")
} | {"linear.drop_inactive"}
"""Functions that a room has at its door for other rooms, not for users."""

VERBS = {n: v for n in jnx.__all__ if inspect.isfunction(v := getattr(jnx, n))} | {
    f"{room}.{name}": verb
    for room, names in ROOMS.items()
    for name in names.split() or dir(getattr(jnx, room))
    if name not in jnx.__all__ and f"{room}.{name}" not in INNER
    if not name.startswith("_")
    and inspect.isfunction(verb := getattr(getattr(jnx, room), name))
}


@cache
def nouns() -> dict:
    """One of each kind of thing that verbs take or give, and things that none takes."""
    data, network = common.dataset(), common.named("one model")
    channels = data.channels
    pool = jnx.polynomial_pool(channels, input_lags=(1,), output_lags=(1,), degree=1)
    selection = jnx.select(pool, data, jnx.ForwardOLS(max_terms=2))
    return {
        "Dataset": data,
        "Network": network,
        "Pool": pool,
        "Selection": selection.value,
        "Solution": selection,
        "Channels": channels,
        "ForwardOLS": jnx.ForwardOLS(),
        "Lolimot": jnx.Lolimot(scheduling=["a[t]"]),
        "SimulationError": jnx.SimulationError(),
        "ActuatorLimits": jnx.inverse.ActuatorLimits(range={"a": (0.0, 1.0)}),
        "class": jnx.SimulationError,
        "array": np.zeros((5, 2)),
        "text": "engine.toml",
        "number": 3,
        "path": Path("engine.toml"),
        "dict": {"a": 1},
        "object": object(),
        "None": None,
    }


FITTING = {
    "network": "Network",
    "inverse": "Network",
    "forward": "Network",
    "data": "Dataset",
    "references": "Dataset",
    "few": "Dataset",
    "earlier": "Dataset",
    "later": "Dataset",
    "validation": "Dataset",
    "train": "Dataset",
    "source": "Pool",
    "pool": "Pool",
    "terms": "Pool",
    "selection": "Selection",
    "channels": "Channels",
    "limits": "ActuatorLimits",
    "trainable": "Network",
    "deviations": "Network",
}
"""What each argument takes; those that no noun here fits are not in it."""

ALSO = {
    ("source", "Selection"),
    ("terms", "Selection"),
}


def arguments(verb: str) -> list[str]:
    return list(inspect.signature(VERBS[verb]).parameters)


@pytest.mark.parametrize("verb", VERBS)
def test_a_wrong_object_is_named(verb):
    parameters = inspect.signature(VERBS[verb]).parameters
    right = {
        n: nouns()[FITTING[n]]
        for n, p in parameters.items()
        if n in FITTING and p.default is p.empty
    }
    for name in [n for n in parameters if n in FITTING]:
        for kind, wrong in nouns().items():
            fits = kind == FITTING[name] or (name, kind) in ALSO
            if verb in ("diagnose", "report") and name == "selection":
                continue  # a table of another kind
            if verb in ("design.plan", "fleet.plan") and name == "limits":
                continue  # numbers by output
            if fits or (kind == "None" and parameters[name].default is None):
                continue
            with pytest.raises(JaxnarxError) as caught:
                VERBS[verb](**right | {name: wrong})
            assert name in str(caught.value) and "\n" not in str(caught.value), kind
            assert isinstance(caught.value, SpecError) and caught.value.field == name


NAMED = {("select", "text"): "there is no selector"}
"""A text is the name of a registered method."""
METHODS = [
    v for v in VERBS if "method" in arguments(v) and not v.endswith("time_constants")
]


@pytest.mark.parametrize("verb", METHODS)
@pytest.mark.parametrize("kind", ["Dataset", "Network", "text", "class", "dict"])
def test_what_is_no_method_is_named(verb, kind):
    told = NAMED.get((verb, kind), f"{VERBS[verb].__name__}: method is")
    named = (verb, kind) in NAMED
    right = [nouns()["Pool"], nouns()["Dataset"]] if named else []
    with pytest.raises(SpecError, match=told) as caught:
        VERBS[verb](*right, method=nouns()[kind])
    assert caught.value.field == "method"


def test_calls_that_used_to_end_in_foreign_errors():
    thing: Any = nouns()
    data, network, selection = (thing[n] for n in ("Dataset", "Network", "Selection"))
    verbs: Any = jnx
    for call, words in {
        lambda: verbs.grow(network, data, thing["Lolimot"]): "of type Network, .*Pool",
        lambda: verbs.select(network, data, verbs.ForwardOLS()): "Pool or Selection",
        lambda: verbs.refine(selection, data): "of type Selection, .* Network",
        lambda: verbs.simulate(selection, data): "of type Selection, .* Network",
        lambda: verbs.simulate(thing["Solution"], data): "hand on its .value",
        lambda: verbs.bands(network, data, network): "of type Dataset, .* Uncertainty",
        lambda: verbs.refine(network, data, verbs.SimulationError): "call the class",
        lambda: verbs.report(selection, data): "of type Selection",
        lambda: verbs.report(network, {"test": "x"}): "data is of type dict",
        lambda: verbs.predict(network, data, "10"): "k is of type str .'10'.",
        lambda: verbs.stack([network, 3]): "networks",
        lambda: verbs.read(5): "path is of type int",
        lambda: verbs.save(data, "x"): "network is of type Dataset",
        lambda: network.regions("speed"): "no modelled output 'speed'.* y",
        lambda: network.regions(7): "no modelled output 7",
    }.items():
        with pytest.raises(SpecError, match=words):
            call()


def test_outputs_go_by_number_and_by_name():
    network = common.named("coupled")
    for o, name in enumerate(network.output_names):
        assert network.regions(o) == network.regions(name)


def test_own_settings_and_subclasses_pass():
    class Lasso:
        pass

    def plain(data: jnx.Dataset, method: jnx.ForwardOLS | jnx.StepwiseF, k: int = 1):
        return method

    verb: Any = guard_arguments(plain)
    data, own = nouns()["Dataset"], Lasso()
    assert verb(data, own) is own
    assert verb(data, jnx.StepwiseF(), k=np.int64(3))
    with pytest.raises(SpecError):
        verb(data, jnx.Lolimot(scheduling=["a[t]"]))
    with pytest.raises(TypeError, match="missing"):
        verb(data)


def test_verbs_are_themselves_under_transforms_and_in_pickles():
    network = common.named("one model")

    @guard_arguments
    def scaled(network: jnx.Network, by: int = 2):
        return network.gain * by

    found = eqx.filter_jit(scaled)(network)
    np.testing.assert_array_equal(found, 2 * network.gain)
    for verb in VERBS.values():
        assert pickle.loads(pickle.dumps(verb)) is verb
    assert inspect.signature(jnx.simulate).parameters["network"].annotation
    assert "Free run" in (jnx.simulate.__doc__ or "")
