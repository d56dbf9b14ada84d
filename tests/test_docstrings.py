"""What `help()` and `print` tell: every setting explained, every example runs."""

import dataclasses
import inspect
import re
import textwrap
from pathlib import Path

import common
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix
import pytest
from common import some

import jaxnarx as jnx
from jaxnarx import settings
from jaxnarx.docstrings import field_texts

PUBLIC = {n: getattr(jnx, n) for n in jnx.__all__} | {
    f"{room}.{name}": getattr(getattr(jnx, room), name)
    for room in (
        *("data", "design", "evaluation", "inverse", "linear", "models"),
        *("refinement", "regressors", "selection", "simulation"),
        *("calibration", "confidence", "control", "exporters", "fleet"),
        "identification",
    )
    for name in dir(getattr(jnx, room))
    if name not in jnx.__all__
}
KINDS = {
    v for n in settings.__all__ if dataclasses.is_dataclass(v := getattr(settings, n))
}
SETTINGS = {n: v for n, v in PUBLIC.items() if isinstance(v, type) and v in KINDS}
FUNCTIONS = {n: v for n, v in PUBLIC.items() if inspect.isfunction(v)}
METHODS = {
    "Dataset.from_arrays": jnx.Dataset.from_arrays,
    "Network.__call__": jnx.Network.__call__,
    "Network.step": jnx.Network.step,
    "Prepared.with_inputs": jnx.simulation.Prepared.with_inputs,
    "StateForm": jnx.models.StateForm,
}
VERBS = FUNCTIONS | METHODS
EXAMPLES = {
    n: textwrap.dedent(found[1])
    for n, told in (VERBS | SETTINGS).items()
    if (
        found := re.search(
            r"\nExample:\n((?:    .*\n?|\n)+)", inspect.getdoc(told) or ""
        )
    )
}
MAIN = (
    "simulate predict select grow refine report check data.suggest_lags read "
    "read_split prepare free_run predict_ahead residual state_space "
    "Dataset.from_arrays polynomial_pool stability uncertainty bands evaluation.cost "
    "diagnose linear.fit_linear run_sweep"
).split()


def test_every_setting_is_explained_in_help():
    unsaid = []
    for name, kind in SETTINGS.items():
        texts, help_ = field_texts(kind), kind.__doc__ or ""
        for field in dataclasses.fields(kind):
            text = texts.get(field.name, "")
            first = f"    {field.name}: {' '.join(text.split()[:2])}"
            if not text.endswith((".", ")")) or first not in help_:
                unsaid.append(f"{name}.{field.name}")
        if help_.startswith("Args:") or help_.count("\nArgs:") != bool(texts):
            unsaid.append(name)
    assert not unsaid


def test_every_settings_class_is_offered_once():
    offered = list(SETTINGS.values())
    assert len(offered) == len(set(offered)) and set(offered) == KINDS


def test_a_verb_explains_its_arguments_and_what_it_returns():
    unsaid = []
    for name in MAIN:
        sections = re.split(r"\n\n(?=\S)", inspect.getdoc(VERBS[name]) or "")
        args = [s for s in sections if s.startswith("Args:\n")]
        explained = re.findall(r"^    (\w+): \S", "\n".join(args), re.M)
        wanted = list(inspect.signature(VERBS[name]).parameters)
        returns = any(s.startswith("Returns:\n    ") for s in sections)
        if len(args) != 1 or explained != wanted or not returns:
            unsaid.append(name)
    assert not unsaid


@pytest.fixture(scope="module")
def scope():
    data = common.dataset((150, 150))
    pool = jnx.polynomial_pool(
        data.channels, outputs=["y"], input_lags=(1,), output_lags=(1,), degree=1
    )
    network = common.named("one model")
    named = {"network": network, "data": data, "pool": pool}
    named |= {"runs": jnx.prepare(network, data), "u": jnp.asarray(data.records[0].u)}
    named |= {"y_measured": jnp.asarray(data.records[0].y[:, :1])}
    libraries = {"jax": jax, "jnp": jnp, "eqx": eqx, "optimistix": optimistix}
    return {"jnx": jnx} | named | libraries


DEAR = {"states.fit_states", "design.plan", "identify", "evaluation.errors_by_size"}


@pytest.mark.parametrize("name", some(EXAMPLES, *set(EXAMPLES) - DEAR))
def test_an_example_runs_as_it_is_printed(name, scope, tmp_path, monkeypatch):
    assert f"jnx.{name}(" in EXAMPLES[name] or name in METHODS
    monkeypatch.chdir(tmp_path)
    # A user's session has jax's own promotion rules.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        exec(compile(EXAMPLES[name], name, "exec"), dict(scope))


def test_there_are_examples():
    told = {"simulate", "predict", "save", "load", "select", "grow", "refine", "report"}
    assert told | {"check", "polynomial_pool", "Dataset.from_arrays"} <= EXAMPLES.keys()
    # None is printed that is not run; those of commands are parsed in tests/shell.
    package = Path(jnx.__file__).parent
    printed = [
        n
        for path in package.rglob("*.py")
        if path.relative_to(package).parts[0] not in ("shell", "docstrings.py")
        for n in re.findall(r"^ *Example:$", path.read_text("utf-8"), re.M)
    ]
    assert len(printed) == len(EXAMPLES)


def test_a_network_prints_its_outputs_regions_terms_and_limits():
    text = str(common.named("coupled"))
    assert text.splitlines()[0].endswith("history: a, b -> y, w")
    assert "y: 3 local models by Gaussians, held within -500 to 500 ppm" in text
    assert "1 (a[t] near -2.4, b[t-2] near -0.4): y[t] = 1 + 2.5 a[t]" in text
    far = dataclasses.replace(net := common.named("coupled"), upper=1e9 + net.upper)
    assert "y: 3 local models by Gaussians\n" in str(far)
    single = str(common.named("one model")).splitlines()
    assert (
        len(single) == 3 and "near" not in single[2] and "1 local model," in single[1]
    )


def test_a_selection_prints_its_terms_in_order(scope):
    pool, data = scope["pool"], scope["data"]
    selection = jnx.select(pool, data, jnx.ForwardOLS(max_terms=2)).value
    lines = str(selection).splitlines()
    assert lines[0] == f"y: 2 of {len(pool.factor)} terms"
    assert [line.split()[-1] for line in lines[1:]] == selection.names
