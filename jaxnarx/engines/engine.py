"""What every virtual engine offers: event-sampled records, steady states, families."""

import abc
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PRNGKeyArray, PyTree, ScalarLike

from jaxnarx.data import Channels, Dataset, Record
from jaxnarx.errors import DataError, SpecError

Engine = TypeVar("Engine", bound="AbstractEngine")


def parameter(default: float) -> Any:
    """A field holding a float leaf, so that families of engines are stacked trees."""
    return eqx.field(default=default, converter=_leaf)


def _leaf(value: ScalarLike) -> Float[Array, ""]:
    # A Python float would be static under filter_jit; an array keeps its dtype.
    return value if isinstance(value, jax.Array) else jnp.asarray(value, dtype=float)


class AbstractEngine(eqx.Module):
    """A virtual engine on its test bench, sampled once per crank-angle event.

    An implementation says what one event does (`rest`, `advance`) and what the columns
    are (`channels`, `ranges`, `noise`, `limits`); records, noise, checks and families
    are made here, once.
    """

    varied: ClassVar[Mapping[str, float]]
    """How far each parameter moves in `perturbed`, relative to `spread`."""

    @property
    @abc.abstractmethod
    def channels(self) -> Channels:
        """Names and units of the inputs and outputs, in the order of the columns."""

    @property
    @abc.abstractmethod
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Usual range of each input, in its unit; for excitation, not enforced."""

    @property
    @abc.abstractmethod
    def limits(self) -> dict[str, tuple[float, float]]:
        """Outputs outside these bounds end a run: the engine has stalled, or worse."""

    @property
    @abc.abstractmethod
    def noise(self) -> dict[str, float]:
        """Standard deviation of the measurement noise of each output, in its unit."""

    @property
    @abc.abstractmethod
    def sample_time(self) -> float:
        """Nominal duration of an event [s]; the true one is in inverse proportion to
        speed."""

    @abc.abstractmethod
    def rest(self, inputs: Float[Array, " inputs"]) -> PyTree[Float[Array, "..."]]:
        """Steady state and filled delay lines under constant `inputs`."""

    @abc.abstractmethod
    def advance(
        self, carry: PyTree[Float[Array, "..."]], inputs: Float[Array, " inputs"]
    ) -> tuple[PyTree[Float[Array, "..."]], Float[Array, " outputs"]]:
        """One event: the outputs at its start, and what `rest` returned at its end."""

    def run(self, inputs: Float[Array, "time inputs"]) -> Float[Array, "time outputs"]:
        """Noise-free outputs per event, from rest under the first inputs.

        Row k is measured at the start of event k, before `inputs[k]` acts. Pure and
        differentiable; after a stall the values mean nothing and may be NaN.
        """

        def event(carry, row):  # a bound method would be hashed, traced leaves and all
            return self.advance(carry, row)

        return jax.lax.scan(event, self.rest(inputs[0]), inputs)[1]

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
        deviations `self.noise` times `noise` (0 switches it off). `names` are the
        records' names, `outputs` the output channels to keep, all when not given.

        All records run in one compiled program, padded to the longest. The dataset's
        sample time is the nominal `self.sample_time`: events are equidistant in crank
        angle, not in time.

        Raises `DataError`, naming record and event, where an output leaves
        `self.limits` or is not finite; a returned record is finite.
        """
        several = isinstance(inputs, Sequence)
        rows = [self._checked(u) for u in (inputs if several else [inputs])]
        names = _names(len(rows)) if names is None else list(names)
        _require(rows, names, noise)
        keep = self._kept(outputs)
        padded = jnp.asarray(_padded(rows), jax.tree.leaves(self)[0].dtype)
        clean, error = map(np.asarray, _run_all(self, padded, key))
        records = []
        for u, y, e, name in zip(rows, clean, error, names, strict=True):
            y, e = y[: len(u)], e[: len(u)]
            self._refuse_faults(y, name)
            valid = np.ones((len(u), u.shape[1] + len(keep)), bool)
            measured = (y + noise * e)[:, keep]
            records.append(Record(u=u, y=measured, valid=valid, name=name))
        chosen = tuple(self.channels.outputs[j] for j in keep)
        channels = Channels(inputs=self.channels.inputs, outputs=chosen)
        return Dataset(tuple(records), channels, self.sample_time)

    def perturbed(self: Engine, key: PRNGKeyArray, spread: ScalarLike) -> Engine:
        """Another engine of the same type.

        Each parameter p named in `varied`, with weight w, becomes p exp(spread w e), e
        standard normal. `jax.vmap` over keys makes a family as one stacked tree.
        """
        draws = jax.random.normal(key, (len(self.varied),))
        spread = jnp.asarray(spread, draws.dtype)
        factors = {
            name: jnp.exp(spread * weight * e)
            for (name, weight), e in zip(self.varied.items(), draws, strict=True)
        }
        old = [getattr(self, name) for name in factors]
        new = [
            p * f.astype(p.dtype) for p, f in zip(old, factors.values(), strict=True)
        ]
        return eqx.tree_at(lambda e: [getattr(e, name) for name in factors], self, new)

    def _checked(self, inputs: ArrayLike) -> Float[np.ndarray, "time inputs"]:
        expected = self.channels.input_names
        u = np.asarray(inputs, float)
        u = u[:, None] if u.ndim == 1 and len(expected) == 1 else u
        if u.ndim != 2 or u.shape[1] != len(expected) or u.shape[0] == 0:
            raise SpecError(
                f"inputs must have shape (time, {len(expected)}) with columns "
                f"{', '.join(expected)}; got {u.shape}",
                field="inputs",
            )
        if not np.isfinite(u).all():
            event = int(np.argmin(np.isfinite(u).all(axis=1)))
            raise SpecError(f"inputs are not finite at event {event}", field="inputs")
        return u

    def _kept(self, outputs: Sequence[str] | None) -> list[int]:
        first = len(self.channels.inputs)
        chosen = self.channels.output_names if outputs is None else outputs
        keep = [self.channels.signal(name) - first for name in chosen]
        if min(keep, default=-1) < 0:
            raise SpecError(
                f"outputs must be among {', '.join(self.channels.output_names)}",
                field="outputs",
            )
        return keep

    def _refuse_faults(self, y: np.ndarray, record: str) -> None:
        finite = np.isfinite(y)
        within = finite.copy()
        for j, name in enumerate(self.channels.output_names):
            low, high = self.limits.get(name, (-np.inf, np.inf))
            within[:, j] &= (y[:, j] >= low) & (y[:, j] <= high)
        if within.all():
            return
        event = int(np.argmin(within.all(axis=1)))
        column = int(np.argmin(within[event]))
        channel = self.channels.outputs[column]
        came = f"{y[event, column]:.6g} {channel.unit}".strip()
        bounds = self.limits.get(channel.name)
        raise DataError(
            f"record {record!r}: {channel.name} is {came} at event {event}"
            + (f", outside {bounds[0]:g} to {bounds[1]:g}" if bounds else "")
            + "; the engine stalls or has no steady state there: use a smaller input "
            "range or longer hold times",
            channel=channel.name,
            row=event,
        )


@eqx.filter_jit
def _run_all(
    engine: AbstractEngine,
    inputs: Float[Array, "records time inputs"],
    key: PRNGKeyArray,
) -> tuple[Float[Array, "records time outputs"], Float[Array, "records time outputs"]]:
    clean = jax.vmap(engine.run)(inputs)
    deviation = [engine.noise[name] for name in engine.channels.output_names]
    draw = jax.random.normal(key, clean.shape, clean.dtype)
    return clean, draw * jnp.asarray(deviation, clean.dtype)[None, None]


def _padded(rows: list[np.ndarray]) -> np.ndarray:
    """One array of all records, each held at its last row up to the longest."""
    length = max(map(len, rows))
    return np.stack(
        [np.pad(u, ((0, length - len(u)), (0, 0)), mode="edge") for u in rows]
    )


def _require(rows: list[np.ndarray], names: list[str], noise: float | int) -> None:
    if not rows or len(names) != len(rows):
        raise SpecError(
            f"got {len(rows)} record(s) and {len(names)} name(s); give at least one "
            "record and one name for each",
            field="names",
        )
    if not 0 <= noise < np.inf:
        raise SpecError(
            f"noise must be a finite factor of at least 0, got {noise}", field="noise"
        )


def _names(count: int) -> list[str]:
    return [f"record {i + 1}" for i in range(count)]
