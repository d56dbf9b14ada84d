"""The verb `domain`: how far records leave what a network was trained on, and where."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.confidence.domain_fit import compute_layers, feature_rows
from jaxnarx.data import Dataset
from jaxnarx.errors import SpecError
from jaxnarx.formatting import page, span_text
from jaxnarx.models import LAYERS, Network
from jaxnarx.simulation import Prepared, match_records
from jaxnarx.solution import RESULTS, Solution

SHOWN_STRETCHES = 10
"""Stretches of time that a table shows."""


@dataclasses.dataclass(frozen=True)
class Excursion:
    """A stretch of time outside: seconds from the record's begin, the largest index,
    and the layer and channel that it is owed to."""

    record: str
    start: float
    end: float
    index: float
    layer: str
    channel: str

    def __str__(self) -> str:
        first, last = span_text(self.start, self.end)
        return (
            f"{self.record}, {first} to {last} s: {self.index:.3g} by "
            f"{self.layer} of {self.channel}"
        )

    _repr_html_ = page


@dataclasses.dataclass(frozen=True, eq=False)
class DomainIndex:
    """The index by record and sample, one at the border and more outside.

    `layer` and `channel` are what the largest value is owed to: positions in
    `layer_names` and `channel_names`. Samples whose inputs are not valid have index 0.
    """

    index: tuple[Float[np.ndarray, " _"], ...]
    layer: tuple[Int[np.ndarray, " _"], ...]
    channel: tuple[Int[np.ndarray, " _"], ...]
    names: tuple[str, ...]
    layer_names: tuple[str, ...]
    channel_names: tuple[str, ...]
    sample_time: float

    def __len__(self) -> int:
        return len(self.index)

    @property
    def outside(self) -> float:
        """Share of all samples beyond the border."""
        return float(np.mean(np.concatenate(self.index) > 1))

    @property
    def excursions(self) -> tuple[Excursion, ...]:
        """Every stretch outside, farthest first."""
        found = []
        for n, index in enumerate(self.index):
            out = np.concatenate([[False], index > 1, [False]])
            edges = np.flatnonzero(out[1:] != out[:-1]).reshape(-1, 2)
            for first, stop in edges.tolist():
                at = first + int(np.argmax(index[first:stop]))
                found.append(
                    Excursion(
                        self.names[n],
                        first * self.sample_time,
                        (stop - 1) * self.sample_time,
                        float(index[at]),
                        self.layer_names[self.layer[n][at]],
                        self.channel_names[self.channel[n][at]],
                    )
                )
        return tuple(sorted(found, key=lambda e: -e.index))

    @property
    def table(self) -> str:
        """Share outside by record, then where it is farthest."""
        lines = [f"{100 * self.outside:.3g} % of the samples are outside the domain"]
        for name, index in zip(self.names, self.index, strict=True):
            share, most = float(np.mean(index > 1)), float(index.max(initial=0.0))
            lines.append(f"  {name}: {100 * share:.3g} %, index up to {most:.3g}")
        worst = self.excursions[:SHOWN_STRETCHES]
        if worst:
            lines.append("farthest outside")
            lines += [f"  {one}" for one in worst]
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.table

    _repr_html_ = page


@guard_arguments
def domain(network: Network, data: Dataset | Prepared) -> Solution[DomainIndex]:
    """Tell how far every sample of these records is outside of the network's training.

    Args:
        network: A model with a domain: one of `identify`, or of
            `jnx.confidence.fit_domain`.
        data: Records with its inputs, at its sample time.

    Returns:
        `value` holds by record `index` (one at the border), and the `layer` and
        `channel` to blame for it; `stats["outside"]` is the share of samples outside,
        `stats["records"]` that of every record.

    Example:
        network = jnx.confidence.fit_domain(network, data)
        print(jnx.domain(network, data).value.table)
    """
    known = network.domain
    if known is None:
        raise SpecError(
            "the network has no domain: jnx.confidence.fit_domain(network, data) fits "
            "one to the records of its training",
            field="network",
        )
    data = match_records(network, data)
    values, blamed = [], []
    rows = feature_rows(known.features, data, None)
    layers, at = compute_layers(known, rows)
    own = np.array(known.inputs)
    first = 0
    for record in data:
        good = record.valid[:, own].all(axis=1)
        count = int(good.sum())
        index = np.zeros((len(record), len(LAYERS)))
        channel = np.zeros((len(record), len(LAYERS)), int)
        index[good] = layers[first : first + count]
        channel[good] = at[first : first + count]
        first += count
        values.append(index)
        blamed.append(channel)
    layer = [value.argmax(axis=1) for value in values]
    pairs = list(zip(blamed, layer, strict=True))
    value = DomainIndex(
        tuple(value.max(axis=1) for value in values),
        tuple(layer),
        tuple(c[np.arange(len(c)), at] for c, at in pairs),
        tuple(data.names),
        LAYERS,
        tuple(network.channels.input_names[s] for s in known.inputs),
        float(data.sample_time),
    )
    stats = {
        "outside": value.outside,
        "records": np.array([np.mean(index > 1) for index in value.index]),
    }
    return Solution(value, RESULTS.ok, stats, f"{100 * value.outside:.3g} % outside")
