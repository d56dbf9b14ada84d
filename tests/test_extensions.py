"""Registries, packages that fill them, and the examples of the documentation."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxnarx as jnx
from jaxnarx import extensions
from jaxnarx.contracts import selector as contract
from jaxnarx.contracts.life import plant, pool
from jaxnarx.data.readers import KINDS, Kind
from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.extensions import Registry, load_packages
from jaxnarx.models import Gaussians
from jaxnarx.settings import PARTITIONS, SELECTORS, Identification
from jaxnarx.settings.tree import from_dict, replace_at

EXAMPLES = Path(__file__).parents[1] / "docs" / "extensions"


def correlated(columns, output, weight):
    """The two terms with the largest correlation."""
    gain = abs(columns @ (weight * output)) / (columns**2 @ weight) ** 0.5
    return gain.argsort()[::-1][:2]


@pytest.fixture
def registered():
    """A selector and a partition of that name; both are forgotten again."""
    names: dict[str, Any] = {"models": 2}
    SELECTORS.register("mine", correlated)
    PARTITIONS.register("mine", halves)
    yield names
    del SELECTORS["mine"], PARTITIONS["mine"]


def halves(scheduling, columns, output, weight):
    """Two Gaussians."""
    centre = jnp.array([[0.25], [0.75]])
    return Gaussians(centre, jnp.full((2, 1), np.log(0.2)))


# registries -----------------------------------------------------------------------


def test_a_registry_holds_its_own_and_what_is_added():
    registry: Registry[Any] = Registry("toy", {"one": int})
    assert registry.register("two", float, example=lambda: 3) is float
    assert dict(registry) == {"one": int, "two": float}
    assert registry.added == {"two": float}
    assert registry.find("two", "to") is float and registry.get("three") is None
    made = registry.example("two")
    assert made is not None and made() == 3 and registry.example("one") is None
    registry.register("two", float)  # a notebook's cell twice
    with pytest.raises(SpecError, match="'two' already"):
        registry.register("two", str)
    with pytest.raises(SpecError, match="'one' already"):
        registry.register("one", int)
    with pytest.raises(SpecError, match="no toy 'tow'.*two"):
        registry.find("tow", "to")


def test_instances_are_told_apart_by_their_parts():
    registry: Registry[Any] = Registry("toy", {})
    registry.register(".a", Kind("a", "csv_file"))
    registry.register(".a", Kind("a", "parquet_file"))  # parts of the same classes
    registry.register(".b", Kind("b", os))
    with pytest.raises(SpecError, match="already"):
        registry.register(".b", Kind("b", sys))


def test_a_suffix_and_a_class_name_are_checked():
    with pytest.raises(SpecError, match="lower case"):
        KINDS.register("SIG", Kind("signals", os))
    with pytest.raises(SpecError, match="name of its class"):
        jnx.models.VALIDITIES.register("Bells", Gaussians)
    assert "SIG" not in KINDS


# by name --------------------------------------------------------------------------


def test_registered_methods_go_by_their_names(registered):
    chosen = jnx.select(pool(), plant(), "mine")
    same = jnx.select(pool(), plant(), correlated)
    assert chosen.value.names == same.value.names
    method = jnx.Given("mine", scheduling="u[t-1]")
    assert len(jnx.grow(pool(), plant(), method).value.regions(0)) == 2
    assert from_dict(Identification, {"select": "mine"}).select is correlated
    tree = replace_at(
        Identification(),
        {"select": "mine", "grow": "lolimot"} | {"grow.scheduling": ["u[t-1]"]},
    )
    assert tree.select is correlated


def test_an_unknown_name_is_told_with_the_known_ones(registered):
    with pytest.raises(SpecError, match="no selector 'mein'. .*mine"):
        jnx.select(pool(), plant(), "mein")
    with pytest.raises(SpecError, match="no partition 'mein'"):
        jnx.grow(pool(), plant(), jnx.Given("mein", scheduling="u[t-1]"))
    with pytest.raises(SpecError, match="select must be one of"):
        from_dict(Identification, {"select": "mein"})
    with pytest.raises(SpecError, match="no target 'fortran'"):
        network = jnx.grow(pool(), plant(), jnx.Global()).value
        jnx.export(network, plant(), to=["fortran"])


# packages -------------------------------------------------------------------------

PACKAGE = """
import pathlib
from jaxnarx.settings import SELECTORS
pathlib.Path(__file__).with_suffix(".loaded").touch()
SELECTORS.register("theirs", lambda columns, output, weight: [0])
"""
LOOK = """
import pathlib, sys
mark = pathlib.Path(sys.argv[1])
import jaxnarx, jaxnarx.settings, jaxnarx.data
from jaxnarx.data.readers import KINDS
assert ".csv" in KINDS and not mark.exists(), "loaded at import"
assert jaxnarx.settings.SELECTORS.get("nobody's") is None and mark.exists()
assert "theirs" in jaxnarx.settings.SELECTORS.added
assert "jax" not in sys.modules
"""


def test_a_package_is_loaded_by_the_first_look_up_that_misses(tmp_path):
    about = tmp_path / "toy-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 1.0\n")
    entry = f"[{extensions.ENTRY_POINT_GROUP}]\ntoy = toy_extension\n"
    (about / "entry_points.txt").write_text(entry)
    (tmp_path / "toy_extension.py").write_text(PACKAGE)
    paths = [str(tmp_path), *filter(None, os.environ.get("PYTHONPATH", "").split(":"))]
    done = subprocess.run(
        [sys.executable, "-c", LOOK, str(tmp_path / "toy_extension.loaded")],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[1],
    )
    assert done.returncode == 0, done.stderr


@dataclasses.dataclass
class Broken:
    """An entry point whose module has a fault."""

    name: str = "broken"
    value: str = "broken.module"

    def load(self):
        raise ImportError("no module named 'nowhere'")


def test_a_package_that_cannot_be_loaded_is_named(monkeypatch):
    monkeypatch.setattr(
        extensions.importlib.metadata, "entry_points", lambda group: [Broken()]
    )
    load_packages.cache_clear()
    try:
        for _ in range(2):  # not only the first time
            with pytest.raises(SpecError, match="'broken' .*ImportError.*'nowhere'"):
                SELECTORS.get("nobody's")
        assert KINDS[".csv"].name == "CSV"  # what is known needs no package
    finally:
        load_packages.cache_clear()


# contracts and examples -----------------------------------------------------------


def last(columns, output, weight):
    """Whatever the data, and more than there is."""
    return [len(columns) - 1, len(columns)]


def test_checks_find_what_is_wrong():
    with pytest.raises(AssertionError):
        contract.chooses_rows_of_its_columns(last)
    with pytest.raises(AssertionError):
        contract.finds_what_the_output_is_made_of(lambda *_: [0])
    with pytest.raises(AssertionError):
        # Unweighted sums look at everything.
        contract.does_not_look_at_samples_without_weight(
            lambda columns, output, weight: np.argsort(columns @ output)[:2]
        )
    with pytest.raises(AssertionError):
        contract.does_not_depend_on_the_order_of_terms(lambda *_: [2, 5])


def run_contracts(names: list[str], folder: Path) -> None:
    """`pytest --pyargs jaxnarx.contracts` over examples, as users call it."""
    place = str(Path(jnx.__file__).parents[1])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "--pyargs", "jaxnarx.contracts"]
        + ["-p", "no:cacheprovider", "-W", "error"],
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join([str(EXAMPLES), place])}
        | {"JAXNARX_EXTENSIONS": ",".join(names)},
        capture_output=True,
        text=True,
        cwd=folder,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    assert " passed" in done.stdout and "skipped" not in done.stdout


@pytest.mark.slow
def test_the_quick_examples_hold_to_their_contracts(tmp_path):
    run_contracts(["selector", "reader", "exporter"], tmp_path)


@pytest.mark.slow
def test_all_examples_hold_to_their_contracts(tmp_path):
    names = sorted(path.stem for path in EXAMPLES.glob("*.py"))
    assert len(names) == 8
    run_contracts(names, tmp_path)


def test_a_file_of_an_added_kind_is_read_as_any_other(tmp_path, monkeypatch):
    monkeypatch.delenv("JAXNARX_DATA", raising=False)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import reader  # pyright: ignore[reportMissingImports]

    try:
        columns = reader.write(tmp_path / "run.sig")
        text = '[data]\nsample_time = 0.1\n[channels.inputs]\nspeed = "rpm"\n'
        text += '[channels.outputs]\nload = ""\n[records]\ntrain = ["*.sig"]\n'
        (tmp_path / "d.toml").write_text(text)
        data = jnx.read(tmp_path / "d.toml")
        np.testing.assert_array_equal(data.records[0].u[:, 0], columns["speed"])
    finally:
        del KINDS[".sig"]
        sys.modules.pop("reader")
    with pytest.raises(DataFileError, match="'.sig' cannot be read"):
        jnx.read(tmp_path / "d.toml")
