"""Measured records brought to a network, once: `prepare`."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.arrays.programs import program
from jaxnarx.checks import choice
from jaxnarx.data import Dataset, match_channels
from jaxnarx.data.batch import Batch, stack
from jaxnarx.errors import DataError, SpecError
from jaxnarx.guard import guarded
from jaxnarx.models import HOLD, Gaps, Network, driving, hold_missing
from jaxnarx.shown import page
from jaxnarx.simulation.masks import Masks, make_masks
from jaxnarx.simulation.runs import RunInputs, drive_of, make_drive

RATE = 1e-6
"""Share by which the sample time of data may differ from the network's."""


@jax.tree_util.register_pytree_node_class
@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Prepared:
    """Records as one network needs them: a pytree of arrays, made by `prepare`.

    Records are padded to one length; what is padding is not `scored`. It can be given
    wherever a `Dataset` can, as long as it is what `prepare` returned: one that has
    been through a transformation (`jit`, `vmap`, `tree.map`) is arrays alone.

    Attributes:
        signals: (records, time, signals), measured, physical units.
        scored: (records, time, outputs), True where an error of the free run counts.
        start: (records,), the first sample of each run; with hidden channels the
            window from which they are estimated begins there.
        first: (records,), the first sample that is predicted.
        end: (records,), one behind the last sample with a valid signal.
        anchors: (records, time), where a run could begin: with a whole valid history.
        drive: What is computed of the signals before any run, scaled.
    """

    signals: Float[Array, "records time signals"]
    valid: Bool[Array, "records time signals"]
    scored: Bool[Array, "records time outputs"]
    start: Int[Array, " records"]
    first: Int[Array, " records"]
    end: Int[Array, " records"]
    anchors: Bool[Array, "records time"]
    drive: RunInputs
    columns: tuple[tuple[int, ...], tuple[int, ...]]
    """Signals that drive the network, and those of the outputs it models."""
    origin: "PreparedFrom | None" = None
    """What it was made of, on the host."""

    def tree_flatten(self) -> tuple[tuple, tuple]:
        """Arrays, and which columns are which; without the origin."""
        arrays = (getattr(self, name) for name in _ARRAYS)
        return tuple(arrays), self.columns

    @classmethod
    def tree_unflatten(cls, columns: tuple, arrays: tuple) -> "Prepared":
        """From what `tree_flatten` gave."""
        made = object.__new__(cls)  # unchecked: what stands in place of arrays varies
        given = dict(zip(_ARRAYS, arrays, strict=True))
        for name, value in (given | {"columns": columns, "origin": None}).items():
            object.__setattr__(made, name, value)
        return made

    @property
    def inputs(self) -> Float[Array, "records time inputs"]:
        """What drives the network, physical units: the columns of its call."""
        return self.signals[..., np.array(self.columns[0], int)]

    @property
    def measured(self) -> Float[Array, "records time outputs"]:
        """Measured outputs that the network models, physical units."""
        return self.signals[..., np.array(self.columns[1], int)]

    def with_inputs(
        self, network: Network, inputs: Float[Array, "records time inputs"]
    ) -> "Prepared":
        """The same records driven by other inputs; can be traced and differentiated.

        Example:
            def peak(u):
                return jnx.free_run(network, runs.with_inputs(network, u)).max()

            slope = jax.jit(jax.grad(peak))(runs.inputs)
        """
        signals, drive = _driven(
            network, self.signals, self.valid, inputs, at=self.columns[0]
        )
        return dataclasses.replace(self, signals=signals, drive=drive, origin=None)

    def __str__(self) -> str:
        records, time = self.anchors.shape[-2:]
        outputs = self.scored.shape[-1]
        return (
            f"Prepared: {records} records of up to {time} samples, "
            f"{self.signals.shape[-1]} signals, {outputs} outputs"
        )

    __repr__ = __str__
    _repr_html_ = page


@program
def _driven(network: Network, signals: Array, valid: Array, inputs: Array, *, at):
    """The signals with other inputs, and what is computed of them."""
    signals = signals.at[..., np.array(at, int)].set(inputs)
    return signals, drive_of(network, signals, valid)


_MASKS = ("start", "first", "end", "anchors")
_ARRAYS = ("signals", "valid", "scored", *_MASKS, "drive")


@dataclasses.dataclass(frozen=True, eq=False)
class PreparedFrom:
    """The records that a `Prepared` was made of, and the network's part in it."""

    data: Dataset
    """The records as they were given."""
    matched: Dataset
    """With the network's channels, in its order."""
    batch: Batch
    masks: Masks
    structure: tuple
    scales: tuple[np.ndarray, ...]


@guarded
def prepare(network: Network, data: Dataset) -> Prepared:
    """Bring records to a network: match, stack, mask, filter and scale them, once.

    The result drives the array functions, which can be traced (`free_run`,
    `predict_ahead`, `residual`), and stands for the data in the verbs, which then do
    not prepare them again. It belongs to networks of the same structure, scales and
    sample time: those of a training, whose coefficients and partitions differ.

    Channels are matched by name; `SpecError` for another sample time and for
    parameters that are not finite, `DataError` where no record can be run.

    Args:
        network: The model.
        data: Records with its channels, at its sample time.

    Returns:
        The `Prepared` records.

    Example:
        runs = jnx.prepare(network, data)
        y = jnx.free_run(network, runs)
        error = jnx.metrics.nrmse(runs.measured, y, runs.scored)
    """
    matched = fitting(network, data)
    return made_of(network, data, matched, stack(matched))


def made_of(
    network: Network, data: Dataset, matched: Dataset, batch: Batch
) -> Prepared:
    """`prepare` of records that are stacked already."""
    masks = make_masks(network, batch, network.window)
    if np.all(masks.start == masks.anchors.shape[1]):
        shortest = min(data, key=len)
        raise DataError(
            f"no record can be run: the model needs {network.before} valid "
            f"measured samples to start from (record {shortest.name!r} has "
            f"{len(shortest)} rows)"
        )
    count = len(network.modelled)
    host = {
        "valid": batch.valid,
        "scored": np.ascontiguousarray(masks.scored[..., :count]),
        **{name: getattr(masks, name) for name in _MASKS},
    }
    own = tuple(network.signals[:count])
    origin = PreparedFrom(
        data, matched, batch, masks, _structure(network), _scales(network)
    )
    return Prepared(
        signals=batch.signals,
        drive=make_drive(network, batch),
        columns=(driving(network), own),
        origin=origin,
        **jax.device_put(host),
    )


def stacked(
    network: Network, data: Dataset, missing: str | None
) -> tuple[Batch, Gaps | None]:
    """The records side by side; with `missing="hold"` inputs held where they are
    missing, and where that is."""
    if missing is None:
        return stack(data), None
    choice(missing, (HOLD,), "missing")
    return hold_missing(network, stack(data), [len(record) for record in data])


def prepared(
    network: Network, data: Dataset | Prepared
) -> tuple[Prepared, PreparedFrom]:
    """The records prepared, unless they are already, and what they were made of.

    `SpecError` where they were prepared for another network, or have been through a
    transformation.
    """
    if not isinstance(data, Prepared):
        data = prepare(network, data)
    origin = _origin_of(data)
    require_finite(network)
    same = origin.structure == _structure(network) and all(
        map(np.array_equal, origin.scales, _scales(network))
    )
    if not same:
        raise SpecError(
            "these records were prepared for another network: its lagged variables, "
            "scales or sample time differ; prepare them for this one",
            field="data",
        )
    return data, origin


def dataset_of(data: Dataset | Prepared) -> Dataset:
    """The records of what is either."""
    return _origin_of(data).data if isinstance(data, Prepared) else data


def _origin_of(data: Prepared) -> PreparedFrom:
    if data.origin is None:
        raise SpecError(
            "these prepared records have been through a transformation and know no "
            "names any more; give the verbs what prepare returned",
            field="data",
        )
    return data.origin


def _structure(network: Network) -> tuple:
    """What of a network decides how records are prepared, static."""
    scheduling = tuple(m.scheduling for m in network.models)
    own = network.channels, network.modelled, network.variables, scheduling
    return *own, network.window, network.outside


def _scales(network: Network) -> tuple[np.ndarray, ...]:
    """The same, arrays."""
    ranges = () if network.plain else (network.low, network.high)
    return tuple(map(np.asarray, (network.gain, network.sample_time, *ranges)))


def batched(network: Network, data: Dataset | Prepared) -> tuple[Dataset, Batch]:
    """`fitting` records, and side by side: at hand where they are prepared."""
    if isinstance(data, Prepared):
        _, origin = prepared(network, data)
        return origin.matched, origin.batch
    matched = fitting(network, data)
    return matched, stack(matched)


def fitting(network: Network, data: Dataset | Prepared) -> Dataset:
    """`data` with the network's channels, in its order.

    `SpecError` where the sample time is another, or where the network's parameters are
    not finite: it could not be told from one that runs away.
    """
    if isinstance(data, Prepared):
        return prepared(network, data)[1].matched
    data, _ = match_channels(data, network.channels)
    _same_sample_time(network, data)
    require_finite(network)
    return data


def require_finite(network: Network) -> None:
    """`SpecError` where a parameter is not finite."""
    for name, model in zip(network.computed_names, network.models, strict=True):
        parts = {"coefficient": model.local.coefficient, "partition": model.validity}
        for part, tree in parts.items():
            leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_inexact_array))
            if not all(np.all(np.isfinite(leaf)) for leaf in leaves):
                raise SpecError(
                    f"the model of {name} has a {part} that is not finite; "
                    "load or grow it anew",
                    field=part,
                )


def _same_sample_time(network: Network, data: Dataset) -> None:
    expected = float(network.sample_time)
    if abs(data.sample_time - expected) > RATE * expected:
        raise SpecError(
            f"the model was identified at a sample time of {expected:g} s, the data "
            f"have {data.sample_time:g} s; resample the data",
            field="sample_time",
        )
