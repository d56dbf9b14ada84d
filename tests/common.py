"""Shared builders: datasets and networks small enough to check by hand.

Networks of every kind the kernels distinguish are built over the same channels and
variables, and `to_oracle` turns any network into the plain one of `oracles.py`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import oracles
import programs
import pytest
from jaxtyping import Array, Float, Shaped

from jaxnarx.arrays.sizes import bucket
from jaxnarx.data import Channel, Channels, Dataset
from jaxnarx.models import Gaussians, LocalModels, Network, OutputModel
from jaxnarx.regressors import Variables

CHANNELS = Channels(
    (Channel("a", "V"), Channel("b")), (Channel("y", "ppm"), Channel("w"))
)
A, B, Y, W = range(4)
"""Signals of `CHANNELS`."""

GAIN = np.array([2.0, 0.5, 10.0, 3.0])
VARIABLES = ((A, 0), (B, 1), (Y, 1), (Y, 2), (W, 1))
"""x_1 ... x_5 of the networks below; scheduling may reach one sample further back."""

Term = tuple[tuple[int, ...], float]


@dataclass(frozen=True)
class Part:
    """One output: terms of every local model, and where each is valid.

    `models[m]` lists (factor row, coefficient); `centre` and `width` belong to the
    scheduling variables scaled by `offset` and `span`.
    """

    models: Sequence[Sequence[Term]]
    scheduling: tuple[tuple[int, int], ...] = ()
    offset: Sequence[float] = ()
    span: Sequence[float] = ()
    centre: Sequence[Sequence[float]] = ((),)
    width: Sequence[Sequence[float]] = ((),)


def some(values: Iterable[Any], *quick: Any) -> list[Any]:
    """Parameters: `quick` are tried by default, the others by the slow tests."""

    def slow(value: Any) -> Any:
        parts = value if isinstance(value, tuple) else (value,)
        return pytest.param(*parts, marks=pytest.mark.slow)

    return [value if value in quick else slow(value) for value in values]


def device(values: Shaped[np.ndarray, "..."]) -> Array:
    """As a jax array; `jnp.asarray` would compile a program for every new shape."""
    return jax.device_put(values)


def output_model(part: Part, *, spare_models: int = 0, spare_slots: int = 0):
    """The part as an `OutputModel`; spare slots hold numbers that must not matter."""
    rows = sorted({row for model in part.models for row, _ in model})
    models = len(part.models) + spare_models
    slots = max(len(model) for model in part.models) + spare_slots
    index = np.zeros((models, slots), int)
    used = np.zeros((models, slots), bool)
    coefficient = np.full((models, slots), 7.0)
    for m, model in enumerate(part.models):
        for s, (row, value) in enumerate(model):
            index[m, s], used[m, s], coefficient[m, s] = rows.index(row), True, value
    dims = len(part.scheduling)
    centre, width = (
        np.concatenate([np.reshape(a, (len(part.models), dims)), fill])
        for a, fill in (
            (part.centre, np.full((spare_models, dims), 0.4)),
            (part.width, np.full((spare_models, dims), 0.9)),
        )
    )
    return OutputModel(
        Variables(part.scheduling),
        device(np.array(part.offset, float)),
        device(np.array(part.span, float)),
        Gaussians(device(centre), device(np.log(width))),
        device(np.arange(models) < len(part.models)),
        LocalModels(device(np.array(rows)), *map(device, (index, used, coefficient))),
    )


def network(
    parts: Sequence[Part],
    modelled: tuple[int, ...] = (0,),
    *,
    bound: float = 50.0,
    variables: tuple[tuple[int, int], ...] = VARIABLES,
    spare_models: int = 0,
    spare_slots: int = 0,
) -> Network:
    """A network over `CHANNELS`, its outputs held within +-`bound` (scaled)."""
    outputs = len(modelled)
    return Network(
        CHANNELS,
        modelled,
        Variables(variables),
        tuple(
            output_model(p, spare_models=spare_models, spare_slots=spare_slots)
            for p in parts
        ),
        *map(
            device,
            (
                GAIN,
                np.full(outputs, -bound),
                np.full(outputs, bound),
                np.array([-20.0, -5.0, -500.0, -150.0]),
                np.array([20.0, 5.0, 500.0, 150.0]),
                np.array(0.1),
            ),
        ),
    )


# Local models of y. Every one has terms of its own; all are stable on the data below.
_FIRST = [((0, 0), 0.1), ((0, 1), 0.5), ((0, 3), 0.6), ((2, 3), -0.2)]
_SECOND = [((0, 3), 0.4), ((0, 2), -0.4), ((1, 4), 0.3), ((3, 4), 0.1), ((0, 0), -0.2)]
_THIRD = [((1, 1), 0.3), ((0, 4), 0.5)]
_COUPLED = [((0, 0, 5), 0.3), ((0, 0, 3), 0.4), ((1, 3, 5), -0.2), ((0, 0, 1), 0.3)]

PARTS = {
    "one": Part([_FIRST]),
    "inputs": Part(
        [_FIRST, _SECOND, _THIRD],
        scheduling=((A, 0), (B, 2)),
        offset=(-4.0, -1.0),
        span=(8.0, 2.0),
        centre=((0.2, 0.3), (0.5, 0.6), (0.8, 0.4)),
        width=((0.3, 0.4), (0.2, 0.5), (0.35, 0.25)),
    ),
    "own": Part(
        [_FIRST, _SECOND, _THIRD],
        scheduling=((A, 1), (Y, 1)),
        offset=(-4.0, -15.0),
        span=(8.0, 30.0),
        centre=((0.25, 0.3), (0.5, 0.7), (0.75, 0.5)),
        width=((0.3, 0.35), (0.25, 0.3), (0.4, 0.3)),
    ),
    "coupled": Part(
        [_COUPLED, _COUPLED[:1] + [((0, 2, 2), 0.5), ((0, 0, 0), 0.2)]],
        scheduling=((B, 0),),
        offset=(-1.0,),
        span=(2.0,),
        centre=((0.25,), (0.75,)),
        width=((0.3,), (0.2,)),
    ),
}

HALVES = Part(
    [[((0, 0), 0.0)]] * 2,
    scheduling=((A, 0),),
    offset=(-1.0,),
    span=(2.0,),
    centre=[[0.25], [0.75]],
    width=[[0.2]] * 2,
)
"""Two local models by a; both say zero, so that the error is y itself."""

KINDS = {
    "one model": (("one",), (0,)),
    "by inputs": (("inputs",), (0,)),
    "by own output": (("own",), (0,)),
    "coupled": (("inputs", "coupled"), (0, 1)),
    "coupled, by own output": (("own", "coupled"), (0, 1)),
}
"""Names of networks: their parts and the modelled outputs."""


def named(kind: str, **options) -> Network:
    """The network of that name in `KINDS`."""
    parts, modelled = KINDS[kind]
    # Without w among the outputs its lag is no feedback; leave it out of the table.
    variables = VARIABLES if len(modelled) > 1 else VARIABLES[:4]
    return network([PARTS[p] for p in parts], modelled, variables=variables, **options)


def to_oracle(net: Network) -> oracles.Network:
    """The same network as plain tables, whatever made it."""
    gain = np.asarray(net.gain)
    outputs = []
    for o, model in enumerate(net.models):
        signal = net.signals[o]
        local = model.local
        assert isinstance(model.validity, Gaussians)
        active = np.flatnonzero(np.asarray(model.active))
        factor, index = np.asarray(local.factor), np.asarray(local.index)
        outputs.append(
            oracles.OutputModel(
                signal=signal,
                variables=net.variables.rows,
                models=[
                    [
                        (tuple(factor[index[m, s]]), float(local.coefficient[m, s]))
                        for s in np.flatnonzero(np.asarray(local.used)[m])
                    ]
                    for m in active
                ],
                schedule=model.scheduling.rows,
                schedule_offset=np.asarray(model.offset).tolist(),
                schedule_gain=np.asarray(model.span).tolist(),
                centre=np.asarray(model.validity.centre)[active],
                width=np.exp(np.asarray(model.validity.log_width))[active],
                lower=float(net.lower[o] * gain[signal]),
                upper=float(net.upper[o] * gain[signal]),
            )
        )
    return oracles.Network(outputs, gain)


def signals(length: int, seed: int = 0) -> Float[np.ndarray, "time signals"]:
    """Coloured inputs a and b, outputs y and w of about the size the networks give."""
    rng = np.random.default_rng([seed, length])
    x = rng.normal(size=(length + 20, 4))
    for t in range(1, len(x)):
        x[t] = 0.6 * x[t - 1] + 0.8 * x[t]
    return x[20:] * np.array([1.6, 0.4, 5.0, 1.5])


BRIEF: dict[str, Any] = {"stability": False, "diagnostics": False, "horizons": (1,)}
"""Settings of a report without what costs most."""

LENGTHS = (60, 45, 3, 52)
TIME = bucket(max(LENGTHS))
"""Samples that a batch of such records has room for."""
"""Record lengths: of the third, every network can predict the last sample only."""


def dataset(
    lengths: Sequence[int] = LENGTHS,
    *,
    seed: int = 0,
) -> Dataset:
    """Records of `signals`, sampled at 0.1 s."""
    return from_rows([signals(n, seed) for n in lengths])


def rows_of(data: Dataset, record: int) -> Float[np.ndarray, "time signals"]:
    """All signals of one record as the oracles want them."""
    r = data.records[record]
    return np.concatenate([r.u, r.y], axis=1)


def assert_said(found, run, tolerance: float) -> None:
    """`found` is the run where this says something; array functions never say NaN."""
    assert np.all(np.isfinite(found))
    said = np.isfinite(run)
    np.testing.assert_allclose(
        np.asarray(found)[said], run[said], rtol=0, atol=tolerance
    )


def from_rows(rows: Sequence[np.ndarray], *, missing: str = "mask") -> Dataset:
    """Records over `CHANNELS` from (time, signals) arrays, NaN for missing samples."""
    return Dataset.from_arrays(
        [r[:, :2] for r in rows],
        [r[:, 2:] for r in rows],
        inputs=CHANNELS.inputs,
        outputs=CHANNELS.outputs,
        sample_time=0.1,
        missing=missing,
    )


REFERENCE = Path(__file__).parents[1] / "experiments" / "thesis" / "reference"


def reference(name: str) -> dict[str, list[str]]:
    """A table of steady states of the beds' specification, by column.

    Entries are text as printed there, so that the last printed digit is known.
    """
    rows = (REFERENCE / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    header, *body = (line.split() for line in rows)
    return dict(zip(header, map(list, zip(*body, strict=True)), strict=True))


def compilations(f: Callable[[], object]) -> int:
    """How many programs XLA compiles while `f` runs."""
    before = programs.made()
    f()
    return programs.made() - before
