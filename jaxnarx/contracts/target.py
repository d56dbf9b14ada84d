"""The contract of an exporter.

`TARGETS.register(name, Target(about, write, prove))`, see `jaxnarx.exporters.target`;
what `write` is given is in `jaxnarx.exporters.form`.
"""

import dataclasses
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from jaxnarx.contracts.life import plant, pool
from jaxnarx.exporters import (
    ExportError,
    Target,
    lower,
    make_cases,
    make_golden,
    write_files,
)
from jaxnarx.models import Gaussians, Network
from jaxnarx.partition import grow
from jaxnarx.settings import Given, Global


def _networks() -> list[Network]:
    """One local model, and three."""
    centre = jnp.asarray([[0.2], [0.5], [0.8]])
    three = Gaussians(centre, jnp.full_like(centre, np.log(0.2)))
    methods = (Global(), Given(three, scheduling=["u[t-1]"]))
    return [grow(pool(), plant(), method).value for method in methods]


def writes_files_of_its_own(target: Target, folder: Path) -> None:
    """Names have no folders and carry the name of the export; the same model gives the
    same files."""
    for network in _networks():
        program = lower(network, "some_name")
        golden = make_golden(program, make_cases(network, program, plant())[0])
        files, again = target.write(program, golden), target.write(program, golden)
        assert files and files == again
        for name, content in files.items():
            assert Path(name).name == name and "some_name" in name
            assert isinstance(content, str | bytes)


def proves_what_it_writes(target: Target, folder: Path) -> None:
    """`prove` runs the files beside the model and tells the difference, or says why
    nothing can be run here; where the model does otherwise it raises ExportError."""
    for n, network in enumerate(_networks()):
        program = lower(network, f"model{n}")
        cases = make_cases(network, program, plant())
        place = folder / str(n)
        place.mkdir()
        write_files(place, target.write(program, make_golden(program, cases[0])))
        found, left_out = target.prove(program, place, cases)
        assert found or left_out, "it is neither proven nor said why not"
        assert all(0 <= difference <= 1e-3 for difference in found.values())
        if not found:
            return
        other = [dataclasses.replace(c, expected=c.expected + 0.1) for c in cases]
        try:
            target.prove(program, place, other)
        except ExportError:
            continue
        raise AssertionError("`prove` does not tell one model from another")


def says_what_it_is(target: Target, folder: Path) -> None:
    """In a few words."""
    assert target.about.strip() and "\n" not in target.about


CHECKS = (says_what_it_is, writes_files_of_its_own, proves_what_it_writes)
