"""Models from files, with the limits they have unless those are not wanted."""

from jaxnarx.models import Network, hold_to_range, load


def loaded(path: str, *, no_limits: bool) -> Network:
    """The model of a file; with `no_limits` it is not held to its trained ranges."""
    network = load(path)
    return hold_to_range(network, None) if no_limits else network
