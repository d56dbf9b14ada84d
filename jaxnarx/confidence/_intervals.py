"""The verb `intervals`: where measurements lie around a free run."""

import dataclasses

import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.confidence.domain_fit import compute_layers, feature_rows
from jaxnarx.confidence.enclosure import AbstractEnclosure
from jaxnarx.confidence.error_model import error_variables_at
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.models import STORED_PROBABILITIES, Network
from jaxnarx.simulation import Prepared, Trajectories, match_records, simulate
from jaxnarx.solution import RESULTS, Solution


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Intervals(AbstractEnclosure):
    """Prediction intervals of a free run, one array per record, in physical units.

    A measurement lies from `lower` to `upper` with probability `level`. `run` is the
    free run they belong to. Infinite where an input is not valid.
    """


@guard_arguments
def intervals(
    network: Network,
    data: Dataset | Prepared,
    *,
    level: float | int = 0.9,
    run: Trajectories | None = None,
) -> Solution[Intervals]:
    """Free run of every record with intervals that hold a share `level` of what is
    measured.

    They come from records left out when the network was made, and widen where the
    domain of the network ends (`jaxnarx.models.error_model`). How well they hold on
    records that took no part is told by a report. `jnx.bands` answers another question:
    how sure the parameters are, if the structure is right.

    Args:
        network: A network with an error model: one of a search, or of
            `jnx.confidence.fit_error_model`.
        data: Records with its channels, at its sample time.
        level: Probability, from .5 to .99.
        run: The free run on `data` where it is at hand.

    Returns:
        `value` holds by record, in physical units, `lower` and `upper`, and the `run`.
        Status as of `simulate`.

    Example:
        known = jnx.confidence.fit_domain(network, data)
        known = jnx.confidence.fit_error_model(known, data)
        found = jnx.intervals(known, data, level=0.9).value
        print(found.lower[0][-1], found.upper[0][-1])
    """
    if not STORED_PROBABILITIES[0] <= level <= STORED_PROBABILITIES[-1]:
        raise SpecError(
            f"level must lie from {STORED_PROBABILITIES[0]} to "
            f"{STORED_PROBABILITIES[-1]}, got {level}",
            field="level",
        )
    known, domain = network.errors, network.domain
    if known is None or domain is None:
        raise SpecError(
            "the network has no error model: jnx.confidence.fit_error_model(network, "
            "data) fits one to records that took no part in its training",
            field="network",
        )
    simulated = Solution(run, RESULTS.ok, {}) if run else simulate(network, data)
    value = simulated.value
    data = match_records(network, data)
    rows = feature_rows(domain.features, data, None)
    index = compute_layers(domain, rows)[0].max(axis=1)
    half = np.full((sum(len(r) for r in data), len(network.modelled)), np.inf)
    for o in range(len(network.modelled)):
        z = error_variables_at(value, rows, index, o)
        half[rows.at_sample, o] = known.reach(o, level) * known.size(o, z)
    edges = np.cumsum([len(r) for r in data])[:-1]
    pairs = list(zip(value.outputs, np.split(half, edges), strict=True))
    found = Intervals(
        value,
        tuple(y - h for y, h in pairs),
        tuple(y + h for y, h in pairs),
        float(level),
    )
    return Solution(found, simulated.status, simulated.stats, simulated.detail)
