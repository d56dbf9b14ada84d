"""Damaged model files: refused, or run to finite numbers; never a foreign error."""

import json
from functools import cache

import common
import numpy as np
import pytest
from battery import mutate
from safetensors import safe_open
from safetensors.numpy import save_file

from jaxnarx.models import load, load_about, save
from jaxnarx.simulation import predict, simulate

pytestmark = pytest.mark.slow

KINDS = ("one model", "by inputs", "coupled, by own output")
NUMBERS = (
    0.0,
    -1.0,
    1e-320,
    5e-324,
    1e30,
    -1e30,
    1e155,
    1e200,
    -1.7e308,
    np.nan,
    np.inf,
)
WORDS = (
    b"null",
    b"-1",
    b"[]",
    b"{}",
    b"1e999",
    b'"os.system"',
    b"9" * 400,
    b"[" * 3000,
)


@cache
def data():
    return common.dataset()


def of_bytes(path, rng):
    """The file's bytes damaged, wherever that is."""
    path.write_bytes(mutate(path.read_bytes(), rng, WORDS))


def unsigned(header):
    """Metadata without the digest, which would refuse every change."""
    known = json.loads(header)
    del known["sha256"]
    return {"jaxnarx": json.dumps(known)}


def of_numbers(path, rng):
    """One to three entries of tensors set to what no identification gives."""
    with safe_open(path, framework="numpy") as file:
        header = unsigned(file.metadata()["jaxnarx"])
        tensors = {name: file.get_tensor(name).copy() for name in file.keys()}  # noqa: SIM118
    for _ in range(int(rng.integers(1, 4))):
        value = tensors[sorted(tensors)[int(rng.integers(len(tensors)))]]
        if not value.size:
            continue
        at = np.unravel_index(int(rng.integers(value.size)), value.shape)
        if value.dtype.kind == "f":
            value[at] = NUMBERS[int(rng.integers(len(NUMBERS)))]
        elif value.dtype == bool:
            value[at] = not value[at]
        else:
            value[at] = int(rng.integers(-3, 9))
    save_file(tensors, path, metadata=header)


def of_words(path, rng):
    """The header damaged as text, in a file that is otherwise whole."""
    with safe_open(path, framework="numpy") as file:
        header = unsigned(file.metadata()["jaxnarx"])["jaxnarx"]
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    spoilt = mutate(header.encode(), rng, WORDS).decode("utf-8", "replace")
    save_file(tensors, path, metadata={"jaxnarx": spoilt})


@pytest.mark.parametrize("damage", [of_bytes, of_numbers, of_words])
def test_a_damaged_model_is_refused_or_runs_to_finite_numbers(
    damage, battery, tmp_path
):
    path = tmp_path / "m.safetensors"

    def attempt(rng):
        kind = KINDS[int(rng.integers(len(KINDS)))]
        save(common.named(kind), path, about={"from": "a test"})
        damage(path, rng)
        network = load(path)
        json.dumps(load_about(path))
        for solution in (simulate(network, data()), predict(network, data(), 3)):
            held = solution.value.limited
            for y, limited in zip(solution.value.outputs, held, strict=True):
                assert np.all(np.isfinite(y)), f"not finite, {solution.status_name}"
                assert limited.shape == y.shape

    ends = battery.run(attempt, seconds=60, megabytes=600)
    assert ends["ModelFileError"] > 0
