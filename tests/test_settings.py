"""The settings tree: tables, paths, kinds, and what is refused."""

import dataclasses
import inspect
import pydoc

import pytest

from jaxnarx import settings
from jaxnarx.docstrings import field_texts
from jaxnarx.errors import SpecError
from jaxnarx.settings import (
    ForwardOLS,
    Given,
    Global,
    Grid,
    Identification,
    Lolimot,
    Placed,
    Polynomial,
    PredictionError,
    SigmoidTree,
    SimulationError,
    SimulationOLS,
    StepwiseF,
)
from jaxnarx.settings.tree import (
    METHOD_KINDS,
    field_hints,
    flatten_table,
    from_dict,
    hint_at,
    replace_at,
    to_dict,
    value_at,
)

TABLE = {
    "pool": {"outputs": ["y"], "input_lags": {"a": [0, 1]}, "degree": 3},
    "select": "stepwise",
    "grow": {
        "method": "axis-tree",
        "scheduling": ["a[t]"],
        "local": {"method": "forward", "max_terms": 4},
    },
    "refine": {"horizons": "auto", "box_cox": {"y": 0.0}},
}


def test_a_table_is_a_tree():
    tree = from_dict(Identification, TABLE | {"refine": {"method": "simulation"}})
    assert tree.pool == Polynomial(outputs=("y",), input_lags={"a": [0, 1]}, degree=3)
    assert tree.select == StepwiseF() and tree.refine == SimulationError()
    few = ForwardOLS(max_terms=4)
    assert tree.grow == SigmoidTree(["a[t]"], oblique=False, local=few)
    assert from_dict(Identification, {}) == Identification()
    assert from_dict(Identification, {"refine": "none"}).refine is None
    usual = from_dict(Identification, {"select": {"rho": 0.1}, "refine": {"ridge": 1}})
    assert usual.select == ForwardOLS(max_terms=25, rho=0.1)
    assert usual.refine == SimulationError(ridge=1)


def test_a_tree_spread_out_is_made_again():
    trees = [
        Identification(),
        from_dict(Identification, TABLE | {"refine": "prediction"}),
        Identification(select=SimulationOLS(), grow=Grid(["a[t]"], models=(3,))),
        Identification(grow=Placed(["a[t]"]), refine=None),
        Identification(grow=Given(len, scheduling=["a[t]"])),
    ]
    for tree in trees:
        assert from_dict(Identification, to_dict(tree)) == tree
        assert replace_at(tree, {}) == tree


def test_every_kind_is_told_apart_by_its_name():
    for name, kind, told in METHOD_KINDS:
        scheduled = {"scheduling": ("a[t]",), "models": (2,)}
        own = {k: v for k, v in scheduled.items() if k in field_hints(kind)}
        assert to_dict(kind(**own, **told))["method"] == name


def test_a_path_changes_one_setting():
    tree = replace_at(
        Identification(), {"grow": "lolimot", "grow.scheduling": ["a[t]"]}
    )
    assert tree.grow == Lolimot(["a[t]"])
    more = replace_at(tree, {"grow.max_models": 3, "refine.train": "joint"})
    assert more.grow == Lolimot(["a[t]"], max_models=3)
    assert more.refine == SimulationError(train="joint")
    assert replace_at(more.refine, {"max_steps": 7}).max_steps == 7
    few = replace_at(tree, {"grow.local.max_terms": 5})
    assert few.grow.local == ForwardOLS(max_terms=5)
    back = replace_at(Identification(refine=None), {"refine.max_steps": 9})
    assert back.refine == SimulationError(max_steps=9)


def test_another_kind_takes_over_what_was_told():
    tree = Identification(
        select=ForwardOLS(max_terms=9, rho=0.1),
        grow=Lolimot(["a[t]"], max_models=3, k_sigma=0.5),
        refine=SimulationError(max_steps=7, window_steps=2),
    )
    other = replace_at(
        tree, {"select": "stepwise", "grow": "tree", "refine": "prediction"}
    )
    assert other.select == StepwiseF(max_terms=9)
    assert other.grow == SigmoidTree(["a[t]"], max_models=3)
    assert other.refine == PredictionError(max_steps=7)
    assert replace_at(tree, {"grow": "global"}).grow == Global()


def test_values_are_found_by_path():
    tree = Identification(grow=Lolimot(["a[t]"]))
    assert (
        value_at(tree, "grow.max_models") == 8 and value_at(tree, "grow") == "lolimot"
    )
    assert value_at(tree, "grow.smoothness") is None
    flat = flatten_table(to_dict(tree))
    assert flat["grow.scheduling"] == ("a[t]",) and flat["select.max_terms"] == 25
    owner, _ = hint_at(Identification, "grow.local.significance")
    assert owner is StepwiseF


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"refin": {}}, "unknown key 'refin'. Did you mean 'refine'"),
        ({"grow": {"max_models": 2}}, "grow needs a method: one of lolimot, tree"),
        ({"grow": "lolimt"}, "grow must be one of .* Did you mean 'lolimot'"),
        ({"grow": "lolimot"}, "grow: Lolimot needs scheduling variables"),
        (
            {"select": {"method": "forward", "max_term": 3}},
            "select has the unknown key",
        ),
        ({"pool": {"degree": 2.5}}, "pool.degree must be a whole number, got 2.5"),
        ({"pool": {"degree": 7}}, "pool.degree must be 1 to 4"),
        ({"pool": {"input_lags": 3}}, "pool.input_lags must be a list or a table"),
        ({"refine": {"method": "simulation", "ridge": True}}, "a number, got True"),
        ({"refine": 3}, "refine must be one of simulation, prediction, none, got 3"),
        (
            {"refine": {"method": "simulation", "train": "x"}},
            "refine.train must be one",
        ),
    ],
)
def test_what_is_wrong_is_named_by_its_path(table, words):
    with pytest.raises(SpecError, match=words):
        from_dict(Identification, table)


@pytest.mark.parametrize("path", ["ridge", "refine.rigde", "grow.local.x", "grow.x.y"])
def test_a_path_that_leads_nowhere_is_refused(path):
    with pytest.raises(SpecError, match="there is no setting"):
        hint_at(Identification, path)


def test_each_setting_is_declared_once_and_explained():
    """A field that a base class has is not written again by its kinds."""
    for name in settings.__all__:
        kind = getattr(settings, name)
        if "__dataclass_fields__" not in vars(kind):
            continue
        texts = field_texts(kind)
        for base in kind.__mro__[1:]:
            own = set(vars(kind).get("__annotations__", {})) - {"_"}
            again = own & set(vars(base).get("__annotations__", {}))
            assert not again, f"{name} repeats {again} of {base.__name__}"
        for field in dataclasses.fields(kind):
            assert texts.get(field.name), f"{name}.{field.name} says nothing"


@pytest.mark.parametrize("kind", dict.fromkeys(kind for _, kind, _ in METHOD_KINDS))
def test_help_shows_plain_types(kind):
    """Messages have the words of a rule; `help` and a signature have the type alone."""
    text = pydoc.plain(pydoc.render_doc(kind))
    assert "Annotated" not in text and "lambda" not in text and "Rule(" not in text
    assert "lambda" not in str(inspect.signature(kind))
