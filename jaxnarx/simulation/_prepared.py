"""Measured records brought to a network, once: `prepare`."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import bucket, program
from jaxnarx.checks import choice
from jaxnarx.data import (
    Batch,
    Dataset,
    Fleet,
    check_precision,
    match_channels,
    stack_records,
)
from jaxnarx.errors import DataError, SpecError
from jaxnarx.formatting import page
from jaxnarx.models import HOLD, Gaps, Network, driving_signals, hold_missing
from jaxnarx.simulation.masks import Masks, make_masks
from jaxnarx.simulation.runs import RunInputs, drive_from_signals, make_drive

SAMPLE_TIME_TOLERANCE = 1e-6
"""Share by which the sample time of data may differ from the network's."""


@jax.tree_util.register_pytree_node_class
@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Prepared:
    """Records as one network needs them: a pytree of arrays, made by `prepare`.

    Records are padded to one length; what is padding is not `scored`. It can be given
    wherever a `Dataset` can, as long as it is what `prepare` returned: one that has
    been through a transformation (`jit`, `vmap`, `tree.map`) is arrays alone, and so is
    that of a fleet, whose arrays have the members as a leading axis, for `vmap`.

    Attributes:
        signals: (records, time, signals), measured, physical units.
        scored: (records, time, outputs), True where an error of the free run counts.
        start: (records,), the first sample of each run; with hidden channels the
            window from which they are estimated begins there.
        first: (records,), the first sample that is predicted.
        end: (records,), one behind the last sample with a valid signal.
        anchors: (records, time), where a run could begin: with a whole valid history.
        drive: Values computed from the signals before any run, scaled.
    """

    signals: Float[Array, "*members records time signals"]
    valid: Bool[Array, "*members records time signals"]
    scored: Bool[Array, "*members records time outputs"]
    start: Int[Array, "*members records"]
    first: Int[Array, "*members records"]
    end: Int[Array, "*members records"]
    anchors: Bool[Array, "*members records time"]
    drive: RunInputs
    columns: tuple[tuple[int, ...], tuple[int, ...]]
    """Signals that drive the network, and those of the outputs it models."""
    origin: "PreparedFrom | None" = None
    """Records and network that it was made of, on the host."""

    def tree_flatten(self) -> tuple[tuple, tuple]:
        """Arrays, and which columns are which; without the origin."""
        arrays = (getattr(self, name) for name in _ARRAY_FIELDS)
        return tuple(arrays), self.columns

    @classmethod
    def tree_unflatten(cls, columns: tuple, arrays: tuple) -> "Prepared":
        """Rebuild from what `tree_flatten` gave."""
        made = object.__new__(cls)  # unchecked: what stands in place of arrays varies
        given = dict(zip(_ARRAY_FIELDS, arrays, strict=True))
        for name, value in (given | {"columns": columns, "origin": None}).items():
            object.__setattr__(made, name, value)
        return made

    @property
    def inputs(self) -> Float[Array, "*members records time inputs"]:
        """The inputs that drive the network, physical units: the columns of its
        call."""
        return self.signals[..., np.array(self.columns[0], int)]

    @property
    def measured(self) -> Float[Array, "*members records time outputs"]:
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
        *members, records, time = self.anchors.shape
        outputs = self.scored.shape[-1]
        many = f"{members[0]} members, each with " if members else ""
        return (
            f"Prepared: {many}{records} records of up to {time} samples, "
            f"{self.signals.shape[-1]} signals, {outputs} outputs"
        )

    __repr__ = __str__
    _repr_html_ = page


@program
def _driven(network: Network, signals: Array, valid: Array, inputs: Array, *, at):
    """The signals with other inputs, and what is computed of them."""
    signals = signals.at[..., np.array(at, int)].set(inputs)
    return signals, drive_from_signals(network, signals, valid)


_MASK_FIELDS = ("start", "first", "end", "anchors")
_ARRAY_FIELDS = ("signals", "valid", "scored", *_MASK_FIELDS, "drive")


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


@guard_arguments
def prepare(
    network: Network, data: Dataset | Fleet, *, part: str = "train"
) -> Prepared:
    """Bring records to a network: match, stack, mask, filter and scale them, once.

    The result drives the array functions, which can be traced (`free_run`,
    `predict_ahead`, `residual`), and stands for the data in the verbs, which then do
    not prepare them again. It belongs to networks of the same structure, scales and
    sample time: those of a training, whose coefficients and partitions differ.

    Channels are matched by name; `SpecError` for another sample time and for
    parameters that are not finite, `DataError` where no record can be run.

    A fleet is prepared for one network, or for a stack of one for every member
    (`jnx.stack`), and has the network's channels in its order. A member without usable
    records has the status `too_short` (`run_status`).

    Args:
        network: The model, or of a fleet one for every member, stacked.
        data: Records with its channels, at its sample time; or a fleet of such.
        part: Part of a fleet, "train", "validation" or "test".

    Returns:
        The `Prepared` records; of a fleet with the members as a leading axis.

    Example:
        runs = jnx.prepare(network, data)
        y = jnx.free_run(network, runs)
        error = jnx.metrics.nrmse(runs.measured, y, runs.scored)

        fleet = jnx.Fleet.from_datasets({"one": data, "other": data}, train=slice(None))
        every = jnx.prepare(network, fleet)
        y = eqx.filter_vmap(jnx.free_run, in_axes=(None, 0))(network, every)
    """
    if isinstance(data, Fleet):
        return _prepare_fleet(network, data, part)
    matched = match_records(network, data)
    return prepare_stacked(network, data, matched, stack_records(matched))


def _prepare_fleet(network: Network, fleet: Fleet, part: str) -> Prepared:
    """All members side by side."""
    choice(part, tuple(fleet.parts), "part")
    if network.channels.measured != fleet.channels:
        raise SpecError(
            "the fleet's channels are not the network's, "
            f"{', '.join(network.channels.measured.names)}; make the fleet of datasets "
            "with these, in this order and in the same units",
            field="data",
        )
    members = len(fleet)
    if np.shape(network.sample_time) not in ((), (members,)):
        raise SpecError(
            f"a fleet of {members} members needs one network, or a stack of "
            f"{members}; this is a stack of {len(network.sample_time)}",
            field="network",
        )
    _require_same_sample_time(network, fleet.sample_time)
    require_finite(network)
    padded = fleet.parts[part]
    _, records, time, _ = padded.signals.shape
    padded = padded.widen(records, bucket(time))
    check_precision(padded.signals.dtype)
    flat = (-1, *padded.signals.shape[2:])
    signals = jax.device_put(padded.signals.reshape(flat))
    batch = Batch(signals, padded.valid.reshape(flat))
    host = _host_arrays(network, batch, make_masks(network, batch, network.window))
    if not host["scored"].any():
        raise DataError(
            f"no record of the fleet can be run: the model needs {network.before} "
            "valid measured samples to start from"
        )
    given = host | {"signals": batch.signals}
    many = {k: a.reshape(members, records, *a.shape[1:]) for k, a in given.items()}
    ready = jax.device_put(many)
    drive = _drive_each(network, ready["signals"], ready["valid"])
    return Prepared(drive=drive, columns=_columns(network), **ready)


@program
def _drive_each(network: Network, signals: Array, valid: Array) -> RunInputs:
    """`drive_from_signals` every member, by its own network where these are stacked."""
    own = 0 if jnp.ndim(network.sample_time) else None
    return eqx.filter_vmap(drive_from_signals, in_axes=(own, 0, 0))(
        network, signals, valid
    )


def _columns(network: Network) -> tuple[tuple[int, ...], tuple[int, ...]]:
    return driving_signals(network), tuple(network.signals[: len(network.modelled)])


def _host_arrays(network: Network, batch: Batch, masks: Masks) -> dict[str, np.ndarray]:
    """Arrays of prepared records that need no program."""
    scored = np.ascontiguousarray(masks.scored[..., : len(network.modelled)])
    own = {name: getattr(masks, name) for name in _MASK_FIELDS}
    return {"valid": batch.valid, "scored": scored, **own}


def prepare_stacked(
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
    origin = PreparedFrom(
        data, matched, batch, masks, _structure(network), _scales(network)
    )
    return Prepared(
        signals=batch.signals,
        drive=make_drive(network, batch),
        columns=_columns(network),
        origin=origin,
        **jax.device_put(_host_arrays(network, batch, masks)),
    )


def stack_fitting(
    network: Network, data: Dataset, missing: str | None
) -> tuple[Batch, Gaps | None]:
    """The records side by side; with `missing="hold"` inputs held where they are
    missing, and where that is."""
    if missing is None:
        return stack_records(data), None
    choice(missing, (HOLD,), "missing")
    return hold_missing(network, stack_records(data), [len(record) for record in data])


def ensure_prepared(
    network: Network, data: Dataset | Prepared
) -> tuple[Prepared, PreparedFrom]:
    """The records prepared, unless they are already, and what they were made of.

    `SpecError` where they were prepared for another network, or have been through a
    transformation.
    """
    if not isinstance(data, Prepared):
        data = prepare(network, data)
    origin = _require_origin(data)
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


def get_dataset(data: Dataset | Prepared) -> Dataset:
    """The records of what is either."""
    return _require_origin(data).data if isinstance(data, Prepared) else data


def _require_origin(data: Prepared) -> PreparedFrom:
    if data.origin is None:
        raise SpecError(
            "these prepared records have been through a transformation and know no "
            "names any more; give the verbs what prepare returned",
            field="data",
        )
    return data.origin


def _structure(network: Network) -> tuple:
    """The structure of a network that decides how records are prepared, static."""
    scheduling = tuple(m.scheduling for m in network.models)
    own = network.channels, network.modelled, network.variables, scheduling
    return *own, network.window, network.outside


def _scales(network: Network) -> tuple[np.ndarray, ...]:
    """The same, arrays."""
    ranges = () if network.plain else (network.low, network.high)
    return tuple(map(np.asarray, (network.gain, network.sample_time, *ranges)))


def stack_batch(network: Network, data: Dataset | Prepared) -> tuple[Dataset, Batch]:
    """Matching records, side by side: at hand where they are prepared."""
    if isinstance(data, Prepared):
        _, origin = ensure_prepared(network, data)
        return origin.matched, origin.batch
    matched = match_records(network, data)
    return matched, stack_records(matched)


def check_records(network: Network, data: Dataset | Prepared) -> Dataset | Prepared:
    """Matching records; such as are prepared already stay so."""
    return (
        ensure_prepared(network, data)[0]
        if isinstance(data, Prepared)
        else match_records(network, data)
    )


def match_records(network: Network, data: Dataset | Prepared) -> Dataset:
    """`data` with the network's channels, in its order.

    `SpecError` where the sample time is another, or where the network's parameters are
    not finite: it could not be told from one that runs away.
    """
    if isinstance(data, Prepared):
        return ensure_prepared(network, data)[1].matched
    data, _ = match_channels(data, network.channels)
    _require_same_sample_time(network, data.sample_time)
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


def _require_same_sample_time(network: Network, found: float) -> None:
    for expected in np.unique(np.asarray(network.sample_time)).tolist():
        if abs(found - expected) > SAMPLE_TIME_TOLERANCE * expected:
            raise SpecError(
                f"the model was identified at a sample time of {expected:g} s, the "
                f"data have {found:g} s; resample the data",
                field="sample_time",
            )
