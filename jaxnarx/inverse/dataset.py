"""Datasets for inverse models: wanted plant outputs as inputs, commands as outputs."""

import dataclasses
import re
from collections.abc import Mapping, Sequence

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require_known
from jaxnarx.data import Channel, Channels, Dataset, Record, delays
from jaxnarx.errors import DataError, SpecError
from jaxnarx.inverse.forward import dead_times
from jaxnarx.models import Network

Lead = int | Mapping[str, int]
"""Samples by which an inverse sees its references ahead, for all targets or by name."""

_AHEAD_PATTERN = re.compile(r"^(?P<name>.+)_ahead(?P<lead>\d+)$", re.DOTALL)


def ahead_name(name: str, lead: int) -> str:
    """Name of a channel seen ahead: `TRQ_ahead3` at t is `TRQ` at t + 3."""
    return f"{name}_ahead{lead}"


def parse_ahead(name: str) -> tuple[str, int] | None:
    """Channel and lead of such a name; None for any other."""
    match = _AHEAD_PATTERN.match(name)
    return None if match is None else (match["name"], int(match["lead"]))


@guard_arguments
def inverse_data(
    data: Dataset,
    *,
    commands: str | Sequence[str],
    targets: str | Sequence[str],
    lead: Lead | None = None,
    forward: Network | None = None,
    states: str | Sequence[str] = (),
) -> Dataset:
    """`data` with inputs and outputs swapped, for an inverse that is a `Network`.

    Outputs are the `commands`, inputs of the plant. Inputs are the `targets`, outputs
    of the plant, each seen `lead` samples ahead, then the plant's other inputs, then
    the measured `states`, outputs that an inverse may use or be scheduled on. A target
    seen ahead is called `TRQ_ahead3`: its value at t is that of TRQ at t + 3, and in
    use it is given the reference. Its lags then reach from t + 3 backwards. Units stay.

    Without `lead` each target is seen ahead by the longest of the dead times from the
    commands to it: those of `forward` where it is given, else those that
    `jaxnarx.data.delays` finds. A record ends `lead` samples (the largest of them)
    before its last one; records that are no longer are left out. Masks move along.

    Thesis section 7.3.
    """
    own = data.channels
    commands, targets, states = _names(commands), _names(targets), _names(states)
    _require_known(commands, own.input_names, "commands")
    _require_known(targets, own.output_names, "targets")
    _require_known(states, own.output_names, "states", empty=True)
    leads = target_leads(data, commands, targets, lead, forward)
    others = [name for name in own.input_names if name not in commands]

    def channel(name: str) -> Channel:
        return own.all[own.signal(name)]

    inputs = [
        Channel(ahead_name(n, k), channel(n).unit)
        for n, k in zip(targets, leads, strict=True)
    ]
    inputs += [channel(name) for name in [*others, *states]]
    channels = Channels(tuple(inputs), tuple(channel(name) for name in commands))
    sources = [(own.signal(n), k) for n, k in zip(targets, leads, strict=True)]
    sources += [(own.signal(n), 0) for n in [*others, *states, *commands]]
    cut = max(leads)
    kept = [record for record in data if len(record) > cut]
    if not kept:
        raise DataError(
            f"no record is longer than the lead of {cut} samples (longest: "
            f"{max((len(r) for r in data), default=0)} rows); give longer records or a "
            "smaller lead"
        )
    records = tuple(_swap_columns(record, sources, cut, len(inputs)) for record in kept)
    return Dataset(records, channels, data.sample_time)


def target_leads(
    data: Dataset,
    commands: Sequence[str],
    targets: Sequence[str],
    lead: Lead | None,
    forward: Network | None = None,
) -> list[int]:
    """The lead of every target [samples], see `inverse_data`."""
    if lead is None:
        return [_find_lead(data, commands, name, forward) for name in targets]
    if isinstance(lead, Mapping):
        missing = [name for name in targets if name not in lead]
        if missing or set(lead) - set(targets):
            raise SpecError(
                f"lead must name every target once ({', '.join(targets)}), got "
                f"{dict(lead)}",
                field="lead",
            )
        leads = [lead[name] for name in targets]
    else:
        leads = [lead] * len(targets)
    for value in leads:
        if isinstance(value, bool) or value < 0:
            raise SpecError(
                f"lead must be whole samples of at least 0, got {value}", field="lead"
            )
    return leads


def _find_lead(
    data: Dataset, commands: Sequence[str], target: str, forward: Network | None
) -> int:
    """The longest dead time from any command to one target."""
    if forward is None:
        found = delays(data)
        each = [found[command, target].samples for command in commands]
        known = [d for d in each if d is not None]
    else:
        _require_known(
            [target], forward.output_names, "targets", what="output of the model"
        )
        row = dead_times(forward)[forward.output_names.index(target)]
        each = [row[forward.channels.signal(command)] for command in commands]
        known = [int(d) for d in each if np.isfinite(d)]
    if not known:
        raise DataError(
            f"no command ({', '.join(commands)}) shows an effect on {target}; give "
            "its lead in samples, or choose commands that act on it",
            channel=target,
        )
    return max(known)


def _swap_columns(
    record: Record, sources: list[tuple[int, int]], cut: int, inputs: int
) -> Record:
    """Columns of (signal, lead), `cut` samples shorter."""
    signals = record.signals
    length = len(record) - cut

    def columns(x: np.ndarray) -> np.ndarray:
        return np.stack([x[k : k + length, s] for s, k in sources], axis=1)

    x = columns(signals)
    return dataclasses.replace(
        record,
        u=x[:, :inputs],
        y=x[:, inputs:],
        valid=columns(record.valid),
        scored=None if record.scored is None else record.scored[:length],
    )


def _names(names: str | Sequence[str]) -> list[str]:
    return [names] if isinstance(names, str) else list(names)


def _require_known(
    names: list[str],
    known: Sequence[str],
    field: str,
    *,
    empty: bool = False,
    what: str = "",
) -> None:
    """SpecError unless the names are there, once each."""
    kind = what or ("input of the plant" if field == "commands" else "plant's output")
    if not names and not empty:
        raise SpecError(f"{field} is empty; name at least one", field=field)
    for name in names:
        require_known(name, known, field, f"{field} names {name!r}, which is no {kind}")
    if len(set(names)) < len(names):
        raise SpecError(f"{field} repeats a name: {names}", field=field)
