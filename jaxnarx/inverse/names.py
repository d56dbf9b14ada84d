"""Commands and targets of a forward network by name."""

from collections.abc import Sequence

from jaxnarx.checks import known_name
from jaxnarx.errors import SpecError
from jaxnarx.models import Network


def positions(
    forward: Network, commands: Sequence[str], targets: Sequence[str]
) -> tuple[list[int], list[int]]:
    """Signals of the commands, and places of the targets among the modelled outputs."""
    known = {
        "commands": (commands, forward.channels.input_names, "an input"),
        "targets": (targets, forward.output_names, "a modelled output"),
    }
    for field, (names, there, what) in known.items():
        if isinstance(names, str) or not names or len(set(names)) < len(names):
            raise SpecError(
                f"{field} must be a list of different names, got {names!r}", field=field
            )
        for name in names:
            known_name(
                name,
                there,
                field,
                f"{field} names {name!r}, which is not {what} of the forward model",
            )
    return (
        [forward.channels.signal(name) for name in commands],
        [forward.output_names.index(name) for name in targets],
    )
