"""One folder for every format: the same records, and the same model, from each."""

import jax
import numpy as np
import pytest
from format_writers import NO_TIME_COLUMN, WRITERS

import jaxnarx as jnx
from jaxnarx.data import read

NAMES = ("cold_1", "cold_2", "warm")


@pytest.fixture(scope="module")
def engine():
    """Three records of the virtual engine of Crossley and Cook."""
    key = jax.random.key(7)
    bed = jnx.engines.CrossleyCook()
    return jnx.engines.records(bed, key, (220, 190, 260), names=NAMES)


@pytest.fixture(scope="module")
def found(engine, tmp_path_factory):
    """What is read of every format."""
    channels = engine.channels
    units = {c.name: c.unit for c in channels.inputs + channels.outputs}
    units |= {"time": "s"}
    every = {}
    for kind, write in WRITERS.items():
        folder = tmp_path_factory.mktemp(kind)
        for record in engine.records:
            x = np.concatenate([record.u, record.y], axis=1)
            time = engine.sample_time * np.arange(len(x))
            columns = {"time": time, **dict(zip(channels.names, x.T, strict=True))}
            write(folder / f"{record.name}.{kind}", columns, units)
        told = ["[data]", *([] if kind in NO_TIME_COLUMN else ['time = "time"'])]
        told += ["unit_row = true"] if kind == "csv" else []
        for what, names in (
            ("inputs", channels.input_names),
            ("outputs", channels.output_names),
        ):
            told.append(f"[channels.{what}]")
            told += [f'"{name}" = "{units[name]}"' for name in names]
        told.append(f'[records]\nfiles = ["*.{kind}"]')
        (folder / "d.toml").write_text("\n".join(told), "utf-8")
        every[kind] = read(folder / "d.toml", root=folder)
    return every


@pytest.mark.parametrize("kind", WRITERS)
def test_records_names_and_units_are_the_same(engine, found, kind):
    data = found[kind]
    assert data.channels == engine.channels
    assert data.sample_time == pytest.approx(engine.sample_time, rel=1e-9)
    assert [record.name for record in data.records] == list(NAMES)
    for own, record in zip(data.records, engine.records, strict=True):
        # a sheet holds fifteen digits
        np.testing.assert_allclose(own.u, record.u, rtol=1e-12)
        np.testing.assert_allclose(own.y, record.y, rtol=1e-12)


def test_the_model_is_the_same(engine, found):
    def chosen(data):
        own = jnx.polynomial_pool(
            data.channels, input_lags=(0, 1, 2), output_lags=(1, 2), degree=1
        )
        return jnx.select(own, data, jnx.ForwardOLS(max_terms=6)).value

    expected = chosen(engine)
    for kind, data in found.items():
        own = chosen(data)
        np.testing.assert_array_equal(own.index, expected.index, err_msg=kind)
        np.testing.assert_allclose(
            *(own.coefficient, expected.coefficient), rtol=1e-8, err_msg=kind
        )
