"""Places of an inverse and of a forward network that the loop fills itself."""

import dataclasses

from jaxnarx.checks import require_known
from jaxnarx.errors import SpecError, suggest
from jaxnarx.inverse.dataset import parse_ahead
from jaxnarx.models import Network
from jaxnarx.regressors import Variables

Place = tuple[int, int, int]
"""Row of a table, entry of the loop's state it is taken from, lag [samples]."""


@dataclasses.dataclass(frozen=True)
class Wiring:
    """The signals between the two networks, by index; static.

    `source` holds for every signal of the inverse the forward network's signal it is
    taken from and how far ahead; the last ones are the commands. `targets` are places
    among the forward network's modelled outputs. `states` and `commands` list, for the
    terms and for the scheduling of every output, the rows that are filled in the loop:
    simulated outputs in the inverse's tables, commands in the forward network's.
    """

    source: tuple[tuple[int, int], ...]
    targets: tuple[int, ...]
    states: tuple[tuple[Place, ...], ...]
    commands: tuple[tuple[Place, ...], ...]

    @property
    def deepest_command(self) -> int:
        """Largest lag at which the forward network looks at a command."""
        return max((lag for one in self.commands for *_, lag in one), default=0)

    @property
    def deepest_state(self) -> int:
        """Largest lag at which the inverse looks at a simulated output."""
        return max((lag for one in self.states for *_, lag in one), default=0)


def wire(inverse: Network, forward: Network) -> Wiring:
    """Match the channels of an inverse to those of a forward network, by name.

    `SpecError` where the inverse's outputs are not inputs of the forward network, where
    an input of it is neither a channel of the forward network nor a modelled output
    seen ahead, where the loop would have to filter what it computes, and where either
    has hidden channels.
    """
    for network in (inverse, forward):
        network.require_measured("A cascade")
    _require_same_time(inverse, forward)
    if inverse.parallel:
        raise SpecError(
            "an inverse whose local models have feedback of their own cannot be given "
            "the limited command back; grow it with feedback of the network",
            field="inverse",
        )
    commands = inverse.output_names
    if len(commands) < len(inverse.channels.outputs):
        raise SpecError(
            "the inverse leaves some of its outputs unmodelled; model every command",
            field="inverse",
        )
    for name in commands:
        require_known(
            name,
            forward.channels.input_names,
            "inverse",
            f"the inverse computes {name!r}, which is no input of the forward model",
        )
    source = tuple(_source(name, forward) for name in inverse.channels.input_names)
    for signal, _ in source:
        if forward.channels.names[signal] in commands:
            raise SpecError(
                f"{forward.channels.names[signal]} is both command and input of the "
                "inverse; leave it out of the inputs, its own past is fed back",
                field="inverse",
            )
    aheads = [
        s
        for n, (s, _) in zip(inverse.channels.inputs, source, strict=True)
        if n.name not in forward.channels.names
    ]
    if not aheads:
        raise SpecError(
            "the inverse has no input such as 'TRQ_ahead3'; make its data with "
            "`inverse_data`",
            field="inverse",
        )
    source += tuple((forward.channels.signal(name), 0) for name in commands)
    tables = inverse.variables, *(m.scheduling for m in inverse.models)
    states = tuple(_states(t, source, forward, inverse) for t in tables)
    places = {forward.channels.signal(n): c for c, n in enumerate(commands)}
    tables = forward.variables, *(m.scheduling for m in forward.models)
    filled = tuple(_commands(t, places, forward) for t in tables)
    targets = tuple(dict.fromkeys(forward.signals.index(s) for s in aheads))
    return Wiring(source, targets, states, filled)


def _require_same_time(inverse: Network, forward: Network) -> None:
    a, b = float(inverse.sample_time), float(forward.sample_time)
    if abs(a - b) > 1e-6 * b:
        raise SpecError(
            f"the inverse has a sample time of {a:g} s, the forward model of {b:g} s; "
            "identify both at the same",
            field="sample_time",
        )


def _source(name: str, forward: Network) -> tuple[int, int]:
    """Signal of the forward network behind an input of the inverse, and its lead."""
    known = forward.channels.names
    if name in known:
        return known.index(name), 0
    parsed = parse_ahead(name)
    if parsed is None or parsed[0] not in known:
        raise SpecError(
            f"the inverse needs {name!r}, which is neither a channel of the forward "
            f"model nor one of its outputs seen ahead. {suggest(name, known)}",
            field="inverse",
        )
    target, lead = parsed
    if target not in forward.output_names:
        raise SpecError(
            f"the inverse has {target} as target, which the forward model does not "
            f"compute (it computes {', '.join(forward.output_names)})",
            field="forward",
        )
    return forward.channels.signal(target), lead


def _states(
    table: Variables, source: tuple, forward: Network, inverse: Network
) -> tuple[Place, ...]:
    """Rows of the inverse that are outputs the forward network simulates."""
    places = []
    for row, (signal, lag, filter_) in enumerate(table.entries):
        origin, _ = source[signal]
        name = inverse.channels.names[signal]
        simulated = origin in forward.signals and name in forward.channels.names
        if not simulated:
            continue
        if lag == 0:
            raise SpecError(
                f"the inverse uses {name} at lag 0, which is known only after its "
                "command; use lags of at least 1 for measured states",
                field="inverse",
            )
        _require_unfiltered(filter_, name, "inverse")
        places.append((row, forward.signals.index(origin), lag))
    return tuple(places)


def _commands(
    table: Variables, places: dict[int, int], forward: Network
) -> tuple[Place, ...]:
    """Rows of the forward network that are commands."""
    found = []
    for row, (signal, lag, filter_) in enumerate(table.entries):
        if signal in places:
            _require_unfiltered(filter_, forward.channels.names[signal], "forward")
            found.append((row, places[signal], lag))
    return tuple(found)


def _require_unfiltered(filter_, name: str, field: str) -> None:
    if filter_ is not None:
        raise SpecError(
            f"the {field} model filters {name}, which the cascade computes sample by "
            "sample; use lags of it in place of filters",
            field=field,
        )
