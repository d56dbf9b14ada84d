"""What whoever calls exported code has to know of the model's policies."""

import textwrap
from collections.abc import Iterable, Sequence

from jaxnarx.models import (
    FARTHEST,
    FLAG,
    HOLD,
    LINEAR,
    NAN,
    Network,
    memory_of,
    trusted_samples,
)
from jaxnarx.targets.form import INDEX

OUTSIDE = {
    FLAG: "Inputs beyond their trained ranges are taken as they are",
    HOLD: "Inputs stay at the edge of their trained ranges",
    LINEAR: "Beyond the trained ranges of the inputs the model goes on to first order",
    NAN: "Beyond the trained ranges of the inputs outputs are NaN",
}
SILENT = {
    HOLD: "outputs are those of the held inputs",
    NAN: "outputs are NaN, while the states go on with held inputs",
}


def notes_of(network: Network, flags: Iterable[str]) -> tuple[str, ...]:
    """A paragraph for each policy."""
    return (_missing(network, flags), _outside(network), _bound(network))


def _missing(network: Network, flags: Iterable[str]) -> str:
    policy = NAN if network.outside == NAN else network.nan
    count = trusted_samples(network)
    time = f"{count * float(network.sample_time):.4g} s"
    index = f", its index is {FARTHEST:g}" if INDEX in flags else ""
    return (
        f"An input that is NaN, infinite, or {FARTHEST:,.0f} times as large as in "
        "training is missing: its last value is held, before the first one the "
        "middle of its trained range. missing counts such samples in a row. The sample "
        f"is extrapolated{index}, and {SILENT[policy]}. invalid is 1 from {count} "
        f"samples in a row ({time}) on, and where an input has been missing since the "
        "start. Measured outputs of the start are treated alike."
    )


def _outside(network: Network) -> str:
    text = f"{OUTSIDE[network.outside]}; such samples are extrapolated."
    if network.hold is None:
        return text
    text += (
        " Reported outputs stay within their trained ranges, widened by "
        f"{100 * float(network.hold):g} % of them"
    )
    if network.outside == HOLD:
        return f"{text}."
    return (
        f"{text} and by the share by which an input is beyond its own; that fades "
        f"with a time constant of {memory_of(network):.4g} samples once it is back."
    )


def _bound(network: Network) -> str:
    hidden = " or on a hidden channel, which enters it" if network.hidden else ""
    return (
        "limited is 1 where the bound of what is fed back has acted on an output"
        f"{hidden}."
    )


def wrapped(notes: Sequence[str], lead: str, width: int = 80) -> list[str]:
    """The paragraphs as lines of a comment, an empty one before each."""
    lines = []
    for note in notes:
        lines += [lead.rstrip()]
        lines += [lead + line for line in textwrap.wrap(note, width - len(lead))]
    return lines
