"""Named, unit-carrying channels: the schema every dataset and every model carries."""

import dataclasses
import functools
import unicodedata
from collections.abc import Mapping, Sequence

from jaxnarx.argument_checks import guard_fields
from jaxnarx.checks import require_known
from jaxnarx.errors import SpecError
from jaxnarx.formatting import page


def require_plain(text: str, what: str, *, field: str) -> None:
    """SpecError where `text` holds characters that act on a terminal or stay unseen.

    Names go to terminals, reports and files. Control and format characters, line ends
    and half surrogates are not in any that a person means to read.
    """
    odd = [c for c in text if unicodedata.category(c) in _UNSEEN_CATEGORIES]
    if odd:
        raise SpecError(
            f"{what} must be of characters that are seen, got {odd[0]!r} in "
            f"{text[:60]!r}",
            field=field,
        )


_UNSEEN_CATEGORIES = ("Cc", "Cf", "Cs", "Zl", "Zp")


@guard_fields
@dataclasses.dataclass(frozen=True)
class Channel:
    """One measured signal. `unit` is free text; the empty string means not stated."""

    name: str
    unit: str = ""

    @property
    def label(self) -> str:
        """Name and unit as they stand on an axis, `speed [rpm]`."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@guard_fields
@dataclasses.dataclass(frozen=True)
class Channels:
    """Input and output channels in the order of the arrays' columns.

    The *signal table* that lagged variables index is inputs, then outputs, then the
    `hidden` channels of a model, which nobody measures and no record holds. Hashable,
    so it can be static in a traced value.
    """

    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    hidden: tuple[Channel, ...] = ()

    def __post_init__(self):
        names = self.names
        for name in names:
            if not isinstance(name, str) or not name.strip():
                raise SpecError(
                    f"channel names must be non-empty text, got {name!r}",
                    field="inputs",
                )
        for text in [*names, *(c.unit for c in self.all)]:
            require_plain(text, "channel names and units", field="inputs")
        repeated = sorted({n for n in names if names.count(n) > 1})
        if repeated:
            raise SpecError(
                f"channel {repeated[0]!r} is named more than once among inputs and "
                "outputs; give every column a name of its own",
                field="inputs",
            )

    def __str__(self) -> str:
        kinds = {"inputs": self.inputs, "outputs": self.outputs, "hidden": self.hidden}
        told = {kind: ", ".join(c.label for c in own) for kind, own in kinds.items()}
        return "\n".join(f"{kind}: {names}" for kind, names in told.items() if names)

    _repr_html_ = page

    @property
    def measured(self) -> "Channels":
        """The channels that records hold."""
        return dataclasses.replace(self, hidden=()) if self.hidden else self

    @property
    def all(self) -> tuple[Channel, ...]:
        """The signal table: inputs, outputs, hidden channels."""
        return self.inputs + self.outputs + self.hidden

    @property
    def names(self) -> list[str]:
        """Names of the signal table."""
        return [c.name for c in self.all]

    @property
    def input_names(self) -> list[str]:
        """Names of the inputs."""
        return [c.name for c in self.inputs]

    @property
    def output_names(self) -> list[str]:
        """Names of the outputs."""
        return [c.name for c in self.outputs]

    def signal(self, name: str) -> int:
        """Index of channel `name` in the signal table; unknown names raise
        SpecError.
        """
        require_known(name, self.names, name, f"unknown channel {name!r}")
        return self.names.index(name)


def make_channels(
    inputs: str | Channel | Sequence[str | Channel],
    outputs: str | Channel | Sequence[str | Channel],
    units: Mapping[str, str] | None,
) -> Channels:
    """The schema; a unit for a channel that does not exist is a SpecError."""
    units = dict(units or {})

    def to_channels(given):
        given = [given] if isinstance(given, str | Channel) else list(given)
        return tuple(
            c if isinstance(c, Channel) else Channel(c, units.get(c, "")) for c in given
        )

    channels = Channels(to_channels(inputs), to_channels(outputs))
    if not channels.outputs:
        raise SpecError("outputs is empty; name at least one output", field="outputs")
    for name, unit in units.items():
        require_known(
            name,
            channels.names,
            "units",
            f"units names the channel {name!r}, which does not exist",
        )
        if not isinstance(unit, str):
            raise SpecError(
                f"the unit of {name} must be text, got {unit!r}", field="units"
            )
    return channels


@functools.cache
def number_channels(inputs: int, outputs: int, hidden: int = 0) -> Channels:
    """Channels `u1`, `u2`, ..., `y1`, ... and hidden `x1`, ... without units."""
    return Channels(
        tuple(Channel(f"u{n + 1}") for n in range(inputs)),
        tuple(Channel(f"y{n + 1}") for n in range(outputs)),
        tuple(Channel(f"x{n + 1}") for n in range(hidden)),
    )
