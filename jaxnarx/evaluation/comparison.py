"""Several models side by side, on one part of the data or on several."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import require_known
from jaxnarx.data import Channel, Dataset
from jaxnarx.errors import SpecError
from jaxnarx.evaluation.rows import FREE_RUN, Row, ScoredSamples, collect, score
from jaxnarx.formatting import align_columns, page
from jaxnarx.models import Network
from jaxnarx.simulation import simulate


@dataclasses.dataclass(frozen=True, eq=False)
class ComparedRecord:
    """One record of one part, measured, and simulated by every model.

    Physical units; `measured` is NaN where it does not count. `fit` [%] by model is
    that of this record, None where the model diverges.
    """

    part: str
    record: str
    time: Float[np.ndarray, " time"]
    measured: Float[np.ndarray, " time"]
    simulated: Mapping[str, Float[np.ndarray, " time"]]
    fit: Mapping[str, float | None]


@dataclasses.dataclass(frozen=True, eq=False)
class ModelComparison:
    """Free runs of several models of one output beside the measurement.

    `pooled[model][part]` is the row of all records of a part together; `records` hold
    the trajectories.
    """

    output: Channel
    pooled: Mapping[str, Mapping[str, Row]]
    records: tuple[ComparedRecord, ...]

    @property
    def parts(self) -> list[str]:
        """Names of the parts in the order given."""
        return list(dict.fromkeys(one.part for one in self.records))

    def worst(self, part: str, model: str | None = None) -> ComparedRecord:
        """The record that a model, by default the first, fits worst."""
        name = next(iter(self.pooled)) if model is None else model
        own = [one for one in self.records if one.part == part]
        return min(own, key=lambda one: _or_least(one.fit[name]))

    @property
    def table(self) -> str:
        """NRMSE of the free run, a row for each model and a column for each part."""
        rows = [(f"{self.output.name}, free run NRMSE", *self.parts)]
        for model, scored in self.pooled.items():
            errors = [scored[part] for part in self.parts]
            told = [r.status if r.nrmse is None else f"{r.nrmse:.4g}" for r in errors]
            rows.append((model, *told))
        return "\n".join(align_columns(rows))

    def __str__(self) -> str:
        return self.table

    _repr_html_ = page


@guard_arguments
def compare(
    models: Network | Mapping[str, Network],
    data: Dataset | Mapping[str, Dataset],
    *,
    output: str | None = None,
) -> ModelComparison:
    """Free runs of several models over the same records.

    Args:
        models: Networks by name, or one alone.
        data: One dataset, or several by the name of their part, such as `"train"` and
            `"test"`.
        output: Name of an output that all model (default: the first of the first).

    Returns:
        Scores by model and part, and the runs; `print` shows the scores.

    Example:
        linear = jnx.grow(pool, data, jnx.Global()).value
        both = {"linear": linear, "network": network}
        print(jnx.evaluation.compare(both, {"train": data[0], "test": data[1]}))
    """
    networks = dict(models) if isinstance(models, Mapping) else {"model": models}
    parts = dict(data) if isinstance(data, Mapping) else {"data": data}
    if not networks or not all(len(part) for part in parts.values()) or not parts:
        raise SpecError("there is nothing to compare", field="data")
    first = next(iter(networks.values()))
    name = first.output_names[0] if output is None else output
    for title, network in networks.items():
        told = f"the model {title!r} has no output {name!r}"
        require_known(name, network.output_names, "output", told)
    channel = first.output_channels[first.output_names.index(name)]
    runs = {
        (title, part): _samples(network, part_data, channel)
        for title, network in networks.items()
        for part, part_data in parts.items()
    }
    rows = {key: score(key[1], FREE_RUN, channel, found) for key, found in runs.items()}
    pooled = {
        title: {part: rows[title, part][0] for part in parts} for title in networks
    }
    records = []
    for part, part_data in parts.items():
        for n, record in enumerate(part_data):
            own = {title: runs[title, part][n] for title in networks}
            fit = {title: rows[title, part][n + 1].fit for title in networks}
            records.append(_record(part, record.name, part_data, own, fit))
    return ModelComparison(channel, pooled, tuple(records))


def _samples(network: Network, data: Dataset, channel: Channel) -> list[ScoredSamples]:
    """Samples of one output, record by record."""
    place = network.output_names.index(channel.name)
    run = simulate(network, data).value
    return collect(data, network.output_channels, run)[place]


def _record(
    part: str,
    name: str,
    data: Dataset,
    own: Mapping[str, ScoredSamples],
    fit: Mapping[str, float | None],
) -> ComparedRecord:
    measured = next(iter(own.values())).measured[:, 0]
    counted = np.any([one.scored[:, 0] for one in own.values()], axis=0)
    return ComparedRecord(
        part,
        name,
        np.arange(len(measured)) * float(data.sample_time),
        np.where(counted, measured, np.nan),
        {title: one.predicted[:, 0] for title, one in own.items()},
        fit,
    )


def _or_least(fit: float | None) -> float:
    return -np.inf if fit is None or np.isnan(fit) else fit
