"""The interface of every virtual engine: event-sampled records, steady states,
limits."""

import abc
import functools
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PRNGKeyArray, PyTree, ScalarLike

from jaxnarx.data import Channels, Dataset, Record
from jaxnarx.deprecation import old_method
from jaxnarx.engines import bench

Engine = TypeVar("Engine", bound="AbstractEngine")

SIDE_BY_SIDE_RECORDS = 8
"""Number of records from which on they run side by side in one loop."""


def parameter(default: float) -> Any:
    """A field holding a float leaf, so that families of engines are stacked trees."""
    return eqx.field(default=default, converter=_leaf)


def _leaf(value: ScalarLike) -> Float[Array, ""]:
    # A Python float would be static under filter_jit; an array keeps its dtype.
    return value if isinstance(value, jax.Array) else jnp.asarray(value, dtype=float)


Borders = Mapping[str, tuple[float, float]]
"""Lowest and highest value by channel."""


class AbstractEngine(eqx.Module):
    """A virtual engine on its test bench, sampled once per event.

    An event is a crank angle or, for the diesel, a time. An implementation says what
    one event does (`rest`, `advance`), what the columns are (`channels`, `ranges`,
    `domain`, `noise`), what is allowed (`margins`, `limits`) and how the bed is usually
    excited (`excite`); records, noise, checks, flags and families are made here, once.
    """

    varied: ClassVar[Mapping[str, float]]
    """How far each parameter moves in `perturb`, relative to `spread`; parameters of
    a part have dotted names."""
    channels: ClassVar[Channels]
    """Names and units of the inputs and outputs, in the order of the columns."""
    ranges: ClassVar[Borders]
    """Usual range of each input, in its unit; for excitation, not enforced."""
    domain: ClassVar[Borders]
    """Range in which the model holds, by input; `simulate` refuses what is outside."""
    limits: ClassVar[Borders]
    """Outputs outside these bounds end a run: the engine has stalled, or worse."""
    noise: ClassVar[Mapping[str, bench.Noise]]
    """Measurement noise of each output."""
    event: ClassVar[float | None]
    """Crank angle of an event [degrees]; None where the bed samples time."""

    @property
    @abc.abstractmethod
    def sample_time(self) -> float:
        """Nominal duration of an event [s]; the true one is in inverse proportion to
        speed where events are crank angles."""

    @abc.abstractmethod
    def steady_state(self, inputs: Float[Array, " inputs"]) -> Float[Array, " states"]:
        """The state that does not change under constant `inputs`; NaN where there is
        none. First derivatives are exact."""

    @abc.abstractmethod
    def rest(self, inputs: Float[Array, " inputs"]) -> PyTree[Float[Array, "..."]]:
        """Steady state and filled delay lines under constant `inputs`."""

    @abc.abstractmethod
    def advance(
        self, carry: PyTree[Float[Array, "..."]], inputs: Float[Array, " inputs"]
    ) -> tuple[PyTree[Float[Array, "..."]], Float[Array, " outputs"]]:
        """One event: the outputs at its start, and what `rest` returned at its end."""

    @abc.abstractmethod
    def margins(
        self, carry: PyTree[Float[Array, "..."]], inputs: Float[Array, " inputs"]
    ) -> dict[str, Float[Array, ""]]:
        """Margins of the engine to each limit at the start of an event.

        Negative, or NaN, where the limit is broken. Only the sign is comparable between
        limits.
        """

    @abc.abstractmethod
    def excite(self, key: PRNGKeyArray, length: int) -> Float[Array, "time inputs"]:
        """The usual excitation of this bed, `length` events long."""

    def run(self, inputs: Float[Array, "time inputs"]) -> Float[Array, "time outputs"]:
        """Noise-free outputs per event, from rest under the first inputs.

        Row k is measured at the start of event k, before `inputs[k]` acts. Pure and
        differentiable; after a stall the values mean nothing and may be NaN.
        """

        def event(carry, row):  # a bound method would be hashed, traced leaves and all
            return self.advance(carry, row)

        return jax.lax.scan(event, self.rest(inputs[0]), inputs)[1]

    def steady_outputs(
        self, inputs: Float[Array, " inputs"]
    ) -> Float[Array, " outputs"]:
        """Noise-free outputs that constant `inputs` end at; NaN where they do not.

        Pure and differentiable.
        """
        return self.advance(self.rest(inputs), inputs)[1]

    def flags(self, inputs: ArrayLike) -> dict[str, Bool[np.ndarray, " time"]]:
        """Which limits each event of a run under `inputs` breaks, by name.

        `inputs` is one record as for `simulate`. A run that breaks soft limits, such as
        smoke, is simulated all the same: its samples can be masked with these flags. A
        stall, or a value that is not finite, breaks limits from then on.
        """
        rows = jnp.asarray(
            bench.check_record(self, inputs), jax.tree.leaves(self)[0].dtype
        )
        return {
            name: ~(np.asarray(margin) >= 0)
            for name, margin in _margins(self, rows).items()
        }

    def simulate(
        self,
        inputs: ArrayLike | Sequence[ArrayLike],
        key: PRNGKeyArray,
        *,
        noise: float | int = 1.0,
        names: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
    ) -> Dataset:
        """Measured records, one for each array of `inputs`, each starting from rest.

        **Arguments:** `inputs` is a (time, inputs) array or a list of them; (time,)
        will do where there is one input. `key` draws the noise, white with the standard
        deviations of `self.noise` times `noise` (0 switches it off). `names` are the
        records' names, `outputs` the output channels to keep, all when not given.

        All records run in one compiled program, padded to the longest. The dataset's
        sample time is the nominal `self.sample_time`: events are equidistant in crank
        angle, not in time, except where the bed samples time.

        Raises `DataError`, naming record and event, where an input leaves
        `self.domain`, or where an output leaves `self.limits` or is not finite: a
        returned record is finite. Soft limits are not enforced, see `flags`.
        """
        several = isinstance(inputs, Sequence)
        rows = [bench.check_record(self, u) for u in (inputs if several else [inputs])]
        names = bench.number_records(len(rows)) if names is None else list(names)
        bench.require(rows, names, noise)
        keep = bench.choose_outputs(self, outputs)
        for u, name in zip(rows, names, strict=True):
            bench.refuse_outside(self, u, name)
        padded = jnp.asarray(bench.pad_records(rows), jax.tree.leaves(self)[0].dtype)
        clean, error = map(np.asarray, _run_all(self, padded, key))
        records = []
        for u, y, e, name in zip(rows, clean, error, names, strict=True):
            y, e = y[: len(u)], e[: len(u)]
            bench.refuse_faults(self, u, y, name)
            valid = np.ones((len(u), u.shape[1] + len(keep)), bool)
            measured = (y + noise * e)[:, keep]
            records.append(Record(u=u, y=measured, valid=valid, name=name))
        chosen = tuple(self.channels.outputs[j] for j in keep)
        channels = Channels(inputs=self.channels.inputs, outputs=chosen)
        return Dataset(tuple(records), channels, self.sample_time)

    def perturb(self: Engine, key: PRNGKeyArray, spread: ScalarLike) -> Engine:
        """Another engine of the same type.

        Each parameter p named in `varied`, with weight w, becomes p exp(spread w e), e
        standard normal. `jax.vmap` over keys makes a family as one stacked tree.
        """
        draws = jax.random.normal(key, (len(self.varied),))
        spread = jnp.asarray(spread, draws.dtype)
        factors = [
            jnp.exp(spread * weight * e)
            for weight, e in zip(self.varied.values(), draws, strict=True)
        ]

        def varied_leaves(engine):
            return [_part(engine, name) for name in self.varied]

        old = varied_leaves(self)
        new = [p * f.astype(p.dtype) for p, f in zip(old, factors, strict=True)]
        return eqx.tree_at(varied_leaves, self, new)

    perturbed = old_method("perturbed", "perturb")


def _part(engine: Any, name: str) -> Any:
    return functools.reduce(getattr, name.split("."), engine)


@eqx.filter_jit
def _margins(
    engine: AbstractEngine, inputs: Float[Array, "time inputs"]
) -> dict[str, Float[Array, " time"]]:
    def event(carry, row):
        return engine.advance(carry, row)[0], engine.margins(carry, row)

    return jax.lax.scan(event, engine.rest(inputs[0]), inputs)[1]


@eqx.filter_jit
def _run_all(
    engine: AbstractEngine,
    inputs: Float[Array, "records time inputs"],
    key: PRNGKeyArray,
) -> tuple[Float[Array, "records time outputs"], Float[Array, "records time outputs"]]:
    """Outputs without noise, and the noise.

    Few records run one after the other: side by side they would share a loop whose
    steps cost several times as much and could skip nothing.
    """
    if len(inputs) < SIDE_BY_SIDE_RECORDS:
        clean = jax.lax.map(lambda u: engine.run(u), inputs)
    else:
        clean = jax.vmap(lambda u: engine.run(u))(inputs)
    sizes = [engine.noise[name] for name in engine.channels.output_names]
    absolute, relative = (jnp.asarray(s, clean.dtype) for s in zip(*sizes, strict=True))
    deviation = absolute[None, None] + relative[None, None] * jnp.abs(clean)
    return clean, jax.random.normal(key, clean.shape, clean.dtype) * deviation
