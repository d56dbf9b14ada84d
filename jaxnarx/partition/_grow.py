"""The verb `grow`: from chosen terms to a network of local models."""

from typing import Any

import jax
import numpy as np

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.arrays import least_squares
from jaxnarx.data import Dataset, match_channels
from jaxnarx.errors import SpecError
from jaxnarx.models import (
    AbstractValidity,
    Network,
    OutputModel,
    assemble,
    global_model,
)
from jaxnarx.partition.clusters import place_output
from jaxnarx.partition.fixed import Regions, fit_given, regions_of_method
from jaxnarx.partition.grid import grid_output
from jaxnarx.partition.iterative import grow_output
from jaxnarx.partition.own_feedback import with_feedback
from jaxnarx.partition.scaffold import scheduling_table, terms_to_use
from jaxnarx.partition.training_rows import TrainingRows, make_training_rows
from jaxnarx.regressors import Pool, variable_names
from jaxnarx.selection import Selection
from jaxnarx.settings import Given, Global, Grid, Lolimot, Placed, SigmoidTree
from jaxnarx.solution import RESULTS, Solution, tell_precision

_least_squares = jax.jit(least_squares)

Method = Given | Global | Grid | Lolimot | Placed | SigmoidTree


@guard_arguments
@tell_precision
def grow(
    source: Selection | Pool,
    data: Dataset,
    method: Method,
    *,
    validation: Dataset | None = None,
    start: Given | Network | AbstractValidity | None = None,
) -> Solution[Network]:
    """Fit a network with the terms of `source` to one-step prediction of `data`.

    `Global()` is one local model by orthogonal least squares. `Lolimot(...)` and
    `SigmoidTree(...)` divide the space of their scheduling variables until their
    criterion deteriorates `patience` times in a row and return the best stage.
    `Placed(...)` takes samples or clusters, `Grid(...)` a partition as it is told,
    `Given(...)` that of a network, a validity function, or what a function of one's own
    returns. With `local` every
    region chooses its own terms, and with `feedback="choose"` whether it is fed back
    its own output or the network's.

    Too few rows and constant scheduling variables raise `DataError`. Status
    `no_improvement` where a criterion ended the growth; `unidentifiable` where terms
    are collinear, or regions of a grid have fewer samples than parameters
    (`stats["poor"]`): those keep the coefficients of the global model.

    Args:
        source: The terms; a pool stands for all of its.
        data: Records with its channels, to be fitted.
        method: How to divide the space.
        validation: Records that criterion `"validation"` scores the free run on.
        start: A network or a validity function of the same scheduling variables, from
            whose regions growth goes on; their local models are fitted first. Gaussians
            of any place and width count as boxes of 1/k_sigma times their width.

    Returns:
        `value` is the network. `stats` of a growth has the figures of all stages per
        output (`models`, `sse`, `aicc`, `bic`, `effective`, `validation` as NRMSE),
        `best`, why it `stopped`: `criterion`, `capacity`, or `data` where every further
        split was refused, as a side's validity would have summed to less than `least`;
        and `stages`, every stage of an output as a network of that output alone. Chosen
        feedback adds `own` and `feedback_nrmse`.

    Example:
        selection = jnx.select(pool, data, jnx.ForwardOLS(max_terms=2))
        print(jnx.grow(selection.value, data, jnx.Global()).value)
    """
    pool, factors = terms_to_use(source)
    data, _ = match_channels(data, pool.channels)
    given = method if isinstance(method, Given) else _start(method, start)
    regions = [] if given is None else regions_of_method(pool, given)
    training = make_training_rows(
        pool,
        factors,
        data,
        _scheduling_names(method, pool, regions),
        source.gain if isinstance(source, Selection) else None,
        None if isinstance(method, Global) else method.local,
    )
    if isinstance(method, Global):
        return _grow_global(training)
    if isinstance(method, Grid):
        made = [grid_output(training, o, method) for o in range(len(factors))]
        return _fit_on_partition(training, made, method, validation)
    if isinstance(method, Placed):
        made = [(place_output(training, o, method), []) for o in range(len(factors))]
        return _fit_on_partition(training, made, method, validation)
    if isinstance(method, Given):
        made = [fit_given(training, *own, method) for own in enumerate(regions)]
        return _fit_on_partition(training, made, method, validation)
    if method.criterion == "validation" and validation is None:
        raise SpecError(
            'criterion="validation" needs records: grow(..., validation=...)',
            field="validation",
        )
    return _grow_stages(training, method, validation, regions)


def _start(method: Method, start: Any) -> Given | None:
    """The partition that a growth goes on from."""
    if start is None:
        return None
    if not isinstance(method, Lolimot | SigmoidTree):
        raise SpecError(
            f"{type(method).__name__} does not grow; start goes with Lolimot and "
            "SigmoidTree, a partition to keep is Given(...)",
            field="start",
        )
    if isinstance(start, Given):
        return start
    own = () if isinstance(start, Network) else method.scheduling
    return Given(start, scheduling=own)


def _assemble(training: TrainingRows, models: list[OutputModel]) -> Network:
    return assemble(training.pool, training.data, training.rows.gain, models)


def _grow_global(training: TrainingRows) -> Solution[Network]:
    factors = training.factors
    models, ranks, conds = [], [], []
    for o, factor in enumerate(factors):
        psi, rank, cond = _least_squares(*training.columns(o), training.weight(o))
        models.append(global_model(factor, training.coefficients(o, psi)))
        ranks.append(int(rank))
        conds.append(float(cond))
    network = _assemble(training, models)
    stats = {"rank": np.array(ranks), "cond": np.array(conds)}
    short = [o for o, f in enumerate(factors) if ranks[o] < len(f)]
    if short:
        o = short[0]
        detail = (
            f"the terms of {network.output_names[o]} have rank {ranks[o]} of "
            f"{len(factors[o])}; remove collinear terms"
        )
        return Solution(network, RESULTS.unidentifiable, stats, detail)
    return _solution(training, network, RESULTS.ok, stats)


def _solution(
    training: TrainingRows,
    network: Network,
    status: RESULTS,
    stats: dict,
    detail: str = "",
) -> Solution[Network]:
    """The solution, unless rounding spoils the network."""
    if told := training.warning(list(network.models)):
        return Solution(network, RESULTS.unidentifiable, stats, told)
    return Solution(network, status, stats, detail)


def _scheduling_names(
    method: Method, pool: Pool, regions: list[Regions]
) -> tuple[str, ...]:
    """Every scheduling variable of any output, once."""
    if isinstance(method, Global):
        return ()
    names = tuple(dict.fromkeys(n for own in regions for n in own.scheduling))
    if isinstance(method, Given):
        return names
    told = variable_names(
        pool.channels, scheduling_table(pool, tuple(method.scheduling))
    )
    for own in regions:
        if set(own.scheduling) != set(told):
            raise SpecError(
                f"the start is scheduled by {', '.join(own.scheduling)}, the growth by "
                f"{', '.join(told)}",
                field="scheduling",
            )
    return names or tuple(method.scheduling)


def _judges(training: TrainingRows, validation: Dataset | None) -> Dataset:
    """The records that decide on the feedback."""
    return training.data if validation is None else validation


def _fit_on_partition(
    training: TrainingRows,
    made: list[tuple[OutputModel, list[int]]],
    method: Given | Grid | Placed,
    validation: Dataset | None,
) -> Solution[Network]:
    """A network on a partition that was not grown."""
    models, poor = zip(*made, strict=True)
    outputs = range(len(models))
    network, found = with_feedback(
        _assemble(training, list(models)),
        _judges(training, validation),
        method.feedback,
    )
    stats: dict[str, Any] = {"poor": list(poor)} | found
    short = [o for o in outputs if poor[o]]
    if not short:
        return _solution(training, network, RESULTS.ok, stats)
    o = short[0]
    listed = ", ".join(str(m + 1) for m in poor[o][:8])
    detail = (
        f"local models {listed} of {network.output_names[o]} have fewer samples than "
        "parameters and keep the global model's; use fewer regions or terms"
    )
    return Solution(network, RESULTS.unidentifiable, stats, detail)


def _grow_stages(
    training: TrainingRows,
    method: Lolimot | SigmoidTree,
    validation: Dataset | None,
    regions: list[Regions],
) -> Solution[Network]:
    models, figures = [], []
    for o in range(len(training.factors)):
        start = regions[o] if regions else None
        model, figure = grow_output(training, o, method, validation, start)
        models.append(model)
        figures.append(figure)
    network, found = with_feedback(
        _assemble(training, models), _judges(training, validation), method.feedback
    )
    stats = {k: [f[k] for f in figures] for k in figures[0]} | found
    if any(f["stopped"] == "criterion" for f in figures):
        return _solution(training, network, RESULTS.no_improvement, stats)
    return _solution(
        training, network, RESULTS.ok, stats, _describe_stop(network, stats)
    )


def _describe_stop(network: Network, stats: dict[str, Any]) -> str:
    """Tell what ended a growth before its capacity."""
    for name, stopped, models, least in zip(
        network.output_names,
        *(stats[k] for k in ("stopped", "models", "least")),
        strict=True,
    ):
        if stopped == "data":
            return (
                f"{name}: growth ended at {models[-1]} local models; any further split "
                f"would leave a side fewer than {least:g} samples by weight"
            )
    return ""
