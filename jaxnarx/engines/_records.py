"""Ready-made sets of records, for demonstrations, experiments and benchmarks."""

from collections.abc import Callable, Sequence

import jax
from jaxtyping import Array, Float, PRNGKeyArray

from jaxnarx.data import Dataset
from jaxnarx.engines.engine import AbstractEngine
from jaxnarx.engines.pfi import Pfi
from jaxnarx.excitation import aprbs

Excitation = Callable[[PRNGKeyArray, int], Float[Array, "time inputs"]]


def records(
    engine: AbstractEngine,
    key: PRNGKeyArray,
    lengths: Sequence[int],
    *,
    names: Sequence[str] | None = None,
    noise: float | int = 1.0,
    outputs: Sequence[str] | None = None,
    excite: Excitation | None = None,
) -> Dataset:
    """Measured records of a bed under its usual excitation.

    One record for each of `lengths`, in events, all different realisations of `excite`,
    a function of key and length, `engine.excite` when not given. The rest is as for
    `engine.simulate`.
    """
    excite = engine.excite if excite is None else excite
    excite_key, noise_key = jax.random.split(key)
    inputs = [
        excite(jax.random.fold_in(excite_key, i), length)
        for i, length in enumerate(lengths)
    ]
    return engine.simulate(inputs, noise_key, noise=noise, names=names, outputs=outputs)


def pfi_siso_records(
    key: PRNGKeyArray,
    lengths: Sequence[int] = (2000, 2000, 2000),
    *,
    names: Sequence[str] | None = ("train", "validate", "test"),
    engine: Pfi | None = None,
    hold: tuple[int, int] = (20, 120),
    noise: float | int = 1.0,
    outputs: Sequence[str] | None = ("speed",),
) -> Dataset:
    """Speed of the port-injected engine under APRBS on its air bleed valve.

    One record for each of `lengths`, in events of 180 degrees, all different
    realisations; `hold` is in events, the amplitude is the valve's usual range 0.38 to
    0.41. `noise` scales the measurement noise of 2.5 rpm. `names` is `None` to number
    the records. Excitation as in section 2.9 of the bed's specification [O].
    """
    engine = Pfi() if engine is None else engine
    span = engine.ranges["duty"]

    def excite(key: PRNGKeyArray, length: int) -> Float[Array, "time inputs"]:
        return aprbs(key, length, hold=hold, amplitude=span)[:, None]

    return records(
        *(engine, key, lengths),
        **{"names": names, "noise": noise, "outputs": outputs, "excite": excite},
    )
