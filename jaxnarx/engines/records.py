"""Ready-made sets of records, for demonstrations and benchmarks."""

from collections.abc import Sequence

import jax
from jaxtyping import PRNGKeyArray

from jaxnarx.data import Dataset
from jaxnarx.data.excitation import aprbs
from jaxnarx.engines.pfi import Pfi


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
    duty_key, noise_key = jax.random.split(key)
    duties = [
        aprbs(
            jax.random.fold_in(duty_key, i),
            length,
            hold=hold,
            amplitude=engine.ranges["duty"],
        )[:, None]
        for i, length in enumerate(lengths)
    ]
    return engine.simulate(duties, noise_key, noise=noise, names=names, outputs=outputs)
