"""A network's policies where it knows nothing, as sentences made from the network.

Every text that states limits or policies (the report, its page, `print`, the headers of
exported code) takes its words from here, so that none can differ from the model:

- inputs beyond their trained ranges (`outside`, see `jaxnarx.models.limits`);
- reported outputs, their margin and how it fades (`hold`);
- inputs that are missing (`nan`, `invalid_after`, see `jaxnarx.models.missing`);
- the bound of what is fed back (`lower`, `upper`);
- the samples that a free run begins with (`history`, `window`).
"""

from jaxnarx.models.domain import LARGEST_INDEX
from jaxnarx.models.limits import overshoot_rule
from jaxnarx.models.missing import input_memory, trusted_samples
from jaxnarx.models.network import Network
from jaxnarx.models.outside import HOLD, NAN, OUTSIDE_WORDS

SILENT_SENTENCES = {
    HOLD: "outputs are those of the held inputs",
    NAN: "outputs are NaN, while the states go on with held inputs",
}


def describe_policies(network: Network) -> tuple[str, ...]:
    """Every statement that holds for a network, as sentences."""
    every = (
        *describe_limits(network),
        describe_bounds(network),
        describe_missing(network),
        describe_start(network),
    )
    return tuple(text for text in every if text)


def describe_limits(network: Network) -> list[str]:
    """The limits of inputs and reported outputs beyond their trained ranges, in
    words."""
    texts = describe_inputs(network), describe_outputs(network)
    return [text for text in texts if text]


def describe_inputs(network: Network) -> str:
    """Describe inputs beyond their trained ranges; empty without inputs.

    Measured outputs that the network looks at and does not model are never held.
    """
    if not network.used:
        return ""
    text = f"{OUTSIDE_WORDS[network.outside].sentence}; such samples are extrapolated."
    inputs = len(network.channels.inputs)
    names = [network.channels.names[s] for s in network.used if s >= inputs]
    if names and not network.plain:
        verb = "is" if len(names) == 1 else "are"
        text += f" Measured {', '.join(names)} {verb} taken as measured."
    return text


def describe_outputs(network: Network) -> str:
    """Describe how far reported outputs may leave their trained ranges."""
    if network.hold is None:
        return "Reported outputs are not held to their trained ranges."
    text = network.margin_text
    if not overshoot_rule(network)[0]:
        return f"{text}."
    return (
        f"{text} and by the share by which an input is beyond its own; that fades "
        f"with a time constant of {input_memory(network):.4g} samples once it is back."
    )


def describe_bounds(network: Network) -> str:
    """Bounds of what is computed and fed back; empty where none can act."""
    texts = [
        f"{name} within {text}"
        for o, name in enumerate(network.computed_names)
        if (text := network.bound_text(o))
    ]
    if not texts:
        return ""
    return f"What is computed and fed back is bounded: {', '.join(texts)}."


def describe_missing(network: Network, exported: str | None = None) -> str:
    """Describe outputs where inputs are missing.

    `exported` is what the header of exported code adds about the domain index; without,
    the sentence says which runs it holds for, and is empty where no input is used.
    """
    if exported is None and not network.used:
        return ""
    policy = NAN if network.outside == NAN else network.nan
    count = trusted_samples(network)
    time = f"{count * float(network.sample_time):.4g} s"
    where = ' in exported code and in runs with missing="hold"' * (exported is None)
    counted = " missing counts such samples in a row." * (exported is not None)
    return (
        f"An input that is NaN, infinite, or {LARGEST_INDEX:,.0f} times as large as in "
        f"training is missing:{where} its last value is held, before the first one the "
        f"middle of its trained range.{counted} The sample is extrapolated"
        f"{exported or ''}, and {SILENT_SENTENCES[policy]}. invalid is 1 from {count} "
        f"samples in a row ({time}) on, and where an input has been missing since the "
        "start."
    )


def describe_start(network: Network) -> str:
    """Samples that a free run needs before its first one."""
    count, step = network.history, float(network.sample_time)
    if not network.before:
        return "A free run begins with the first sample of a record."
    text = f"A free run begins with {count} measured samples ({count * step:.4g} s)"
    if network.window:
        text += (
            f", and with {network.window} more that its hidden states are estimated "
            "from"
        )
    return f"{text}; until then outputs are those measured."
