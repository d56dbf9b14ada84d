"""What `help()` and `print` tell: every setting explained, every example runs."""

import dataclasses
import inspect
import re
import textwrap

import common
import jax
import pytest

import jaxnarx as jnx
from jaxnarx import methods
from jaxnarx.texts import field_texts

SETTINGS = [n for n in jnx.__all__ if isinstance(getattr(methods, n, None), type)]
EXAMPLES = {
    n: textwrap.dedent(found[1])
    for n in jnx.__all__
    if inspect.isfunction(verb := getattr(jnx, n))
    and (found := re.search(r"\nExample:\n(.*)", inspect.getdoc(verb) or "", re.S))
}


@pytest.mark.parametrize("name", SETTINGS)
def test_every_setting_is_explained_in_help(name):
    settings = getattr(jnx, name)
    texts = field_texts(settings)
    for field in dataclasses.fields(settings):
        assert texts[field.name].endswith((".", ")")), field.name
        first = " ".join(texts[field.name].split()[:2])
        assert f"    {field.name}: {first}" in settings.__doc__
    assert not settings.__doc__.startswith("Args:")


@pytest.fixture(scope="module")
def scope():
    network = common.named("coupled")
    return {"jnx": jnx, "network": network, "data": common.dataset()}


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs_as_it_is_printed(name, scope, tmp_path, monkeypatch):
    assert f"jnx.{name}(" in EXAMPLES[name]
    monkeypatch.chdir(tmp_path)
    # A user's session has jax's own promotion rules.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        exec(compile(EXAMPLES[name], name, "exec"), dict(scope))


def test_there_are_examples():
    assert {"simulate", "predict", "save", "load"} <= EXAMPLES.keys()


def test_a_network_prints_its_outputs_regions_terms_and_limits():
    text = str(common.named("coupled"))
    assert text.splitlines()[0].endswith("history: a, b -> y, w")
    assert "y: 3 local models by Gaussians, held within -500 to 500 ppm" in text
    assert "1 (a[t] near -2.4, b[t-2] near -0.4): 1, a[t], y[t-1]" in text
    single = str(common.named("one model")).splitlines()
    assert (
        len(single) == 3 and "near" not in single[2] and "1 local model," in single[1]
    )


def test_a_selection_prints_its_terms_in_order():
    data = common.dataset()
    pool = jnx.polynomial_pool(
        data.channels, outputs=["y"], input_lags=(1,), output_lags=(1,), degree=1
    )
    selection = jnx.select(pool, data, jnx.ForwardOLS(max_terms=2)).value
    lines = str(selection).splitlines()
    assert lines[0] == f"y: 2 of {len(pool.factor)} terms"
    assert [line.split()[-1] for line in lines[1:]] == selection.names
