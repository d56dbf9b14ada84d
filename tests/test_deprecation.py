"""Old names warn, and are the new ones."""

import pytest

import jaxnarx as jnx
from jaxnarx import data, models, partition, sweep
from jaxnarx.deprecation import old_method

FUNCTIONS = [
    (data, "in_units", "convert_units"),
    (data, "shortened", "thin_records"),
    (models, "fed_back", "fed_back_variables"),
    (partition, "scattered", "scatter_partition"),
    (sweep, "so_far", "describe_progress"),
]

METHODS = [
    (jnx.Network, "within", "hold_inputs"),
    (jnx.Report, "pooled", "pooled_row"),
    (jnx.Selection, "narrowed", "narrow_pool"),
    (jnx.data.Groups, "left_out", "held_out_samples"),
    (jnx.data.Groups, "parted", "exclude_group"),
    (jnx.data.Padded, "widened", "widen"),
    (jnx.data.Changes, "masked", "count_masked"),
    (jnx.data.Preparation, "after", "prepend"),
    (jnx.engines.AbstractEngine, "perturbed", "perturb"),
    (jnx.evaluation.FreeRunResiduals, "found", "significant_inputs"),
    (jnx.exporters.SampleProgram, "needed", "needed_operations"),
    (jnx.identification.Leaderboard, "chosen", "choose"),
    (jnx.identification.SearchFolder, "added", "add"),
    (jnx.identification.SearchFolder, "finished", "is_finished"),
    (jnx.models.AbstractValidity, "replaced", "replace_parameters"),
    (jnx.sweep.IdentificationWork, "prepared_for", "prepare_case"),
]


@pytest.mark.parametrize(("room", "old", "new"), FUNCTIONS)
def test_old_functions_are_the_new_ones(room, old, new):
    with pytest.warns(DeprecationWarning, match=f"{old} is now {new}"):
        assert getattr(room, old) is getattr(room, new)


@pytest.mark.parametrize(("kind", "old", "new"), METHODS)
def test_old_methods_call_those_that_are_there(kind, old, new):
    assert callable(getattr(kind, new))
    assert getattr(kind, old).__doc__ == f"Old name of `{new}`, for one release more."


def test_an_old_method_warns_where_it_is_called():
    class Sum:
        def add(self, a, *, twice=False):
            return a + a if twice else a

        plus = old_method("plus", "add")

    with pytest.warns(DeprecationWarning, match="Sum.plus is now add"):
        assert Sum().plus(2, twice=True) == 4


def test_other_names_are_unknown():
    for room in {room for room, *_ in FUNCTIONS}:
        with pytest.raises(AttributeError, match="'nothing'"):
            _ = room.nothing
