"""Models from files, with the limits they have unless those are not wanted."""

from jaxnarx.models import Network, hold_to_range, load


def load_model(path: str, *, no_limits: bool, outside: str | None = None) -> Network:
    """The model of a file; with `no_limits` it is not held to its trained ranges, and
    beyond those of its inputs it goes on as `outside` says, if anything."""
    network = load(path)
    if no_limits:
        return hold_to_range(network, None, outside=outside)
    if outside is None:
        return network
    margin = None if network.hold is None else float(network.hold)
    return hold_to_range(network, margin, outside=outside)
