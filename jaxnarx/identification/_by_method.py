"""The verbs `select`, `grow` and `refine` in a row, by one settings tree."""

from collections.abc import Callable
from typing import Any

from jaxnarx.data import Channels, Dataset, match_channels
from jaxnarx.identification.pools import make_pool
from jaxnarx.models import Network
from jaxnarx.partition import grow
from jaxnarx.refinement import refine
from jaxnarx.regressors import Pool, parse_variable
from jaxnarx.selection import Selection, select
from jaxnarx.settings import Global, Identification
from jaxnarx.solution import RESULTS, Solution

Events = Callable[[dict[str, Any]], None]


def run_method(
    data: Dataset,
    method: Identification,
    validation: Dataset | None,
    progress: Events | None,
) -> Solution[Network]:
    """The verbs in a row; see `jaxnarx.identify`."""

    def tell(verb: str, row: dict[str, Any]) -> None:
        if progress is not None:
            progress({"verb": verb} | row)

    data = drop_unneeded(data, method)
    if validation is not None:
        validation = match_channels(validation, data.channels)[0]
    pool = make_pool(method.pool, data.channels)
    tell("select", {"candidates": len(pool)})
    chosen = select(pool, data, method.select, progress=lambda row: tell("select", row))
    tell("select", {"solution": chosen})
    grown = _grow(chosen, data, validation, method)
    tell("grow", {"solution": grown})
    fit, refined = grown, None
    if method.refine is not None:
        fit = refined = refine(
            grown.value,
            data,
            method.refine,
            validation=validation,
            progress=lambda row: tell("refine", row),
        )
        tell("refine", {"solution": refined})
    stats = {"selection": chosen, "grown": grown, "refined": refined}
    failed = next((s for s in (chosen, grown) if not s.is_okay), fit)
    told = failed if fit.is_okay else fit
    return Solution(fit.value, told.status, stats, told.detail)


def _grow(
    chosen: Solution[Selection],
    data: Dataset,
    validation: Dataset | None,
    method: Identification,
) -> Solution[Network]:
    """The network to refine: of one model, what a choice in free run ended with."""
    network = chosen.stats.get("network")
    if network is not None and isinstance(method.grow, Global):
        return Solution(network, RESULTS.ok, {})
    return grow(chosen.value, data, method.grow, validation=validation)


def drop_unneeded(data: Dataset, method: Identification) -> Dataset:
    """The data without outputs that the model neither computes nor is scheduled on.

    New data would otherwise have to bring them along.
    """
    if isinstance(method.pool, Pool):
        return data
    known = data.channels
    scheduling = getattr(method.grow, "scheduling", ())
    used = {known.names[parse_variable(known, text)[0]] for text in scheduling}
    modelled = method.pool.outputs or known.output_names
    kept = tuple(c for c in known.outputs if c.name in used.union(modelled))
    if len(kept) == len(known.outputs):
        return data
    return match_channels(data, Channels(known.inputs, kept))[0]
