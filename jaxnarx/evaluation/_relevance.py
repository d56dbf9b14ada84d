"""How much a network's free run owes to each input: the run without what it tells."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.checks import choice
from jaxnarx.data import Channel, Dataset
from jaxnarx.errors import SpecError
from jaxnarx.evaluation.rows import collect
from jaxnarx.formatting import align_columns, page
from jaxnarx.metrics import nrmse
from jaxnarx.models import Network
from jaxnarx.simulation import Trajectories, match_records, simulate

DEFAULT_BLOCKS = 20
"""Blocks into which all samples are cut where nothing is said."""


@dataclasses.dataclass(frozen=True, eq=False)
class Relevance:
    """Free-run error with one input held at its mean, or permuted in blocks.

    NRMSE over all records, infinite where one diverges: `complete` of the run with
    every input, `without[i]` with input i withheld. `moved` is the root mean square of
    what withholding it changes in the simulated output, over the output's standard
    deviation: an input may move the run without making it better.
    """

    outputs: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    complete: Float[np.ndarray, " outputs"]
    without: Float[np.ndarray, "inputs outputs"]
    moved: Float[np.ndarray, "inputs outputs"]
    how: str

    def order(self, output: int = 0) -> list[int]:
        """Inputs from the one that is missed most to the one missed least."""
        return np.argsort(-self.without[:, output], kind="stable").tolist()

    @property
    def table(self) -> str:
        """The error without each input by output, the one missed most first."""
        lines = []
        for o, output in enumerate(self.outputs):
            lines.append(
                f"{output.name}: free run NRMSE {self.complete[o]:.4g} with all inputs"
            )
            rows = [("without", "NRMSE", "moves the run by")]
            for i in self.order(o):
                error = self.without[i, o]
                told = f"{error:.4g}" if np.isfinite(error) else "diverged"
                rows.append((self.inputs[i].name, told, f"{self.moved[i, o]:.4g}"))
            lines += [f"  {line}" for line in align_columns(rows)]
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.table

    _repr_html_ = page


@guard_arguments
def relevance(
    network: Network,
    data: Dataset,
    *,
    how: str = "mean",
    key: Array | None = None,
    block: float | int | None = None,
) -> Relevance:
    """Free-run error when the network is kept from one input at a time.

    Args:
        network: The model.
        data: Records with its channels, at its sample time; best those of a test.
        how: `"mean"` holds the input at its mean over all records; `"permuted"` cuts
            it into blocks and changes their order across all records, which keeps its
            values and their course within a block.
        key: Randomness of a permutation.
        block: Length of a block [s], by default a twentieth of all samples; longer
            than the memory of the process is right.

    Returns:
        `without` holds the error by input and output; `print` shows it as a table.

    Reference: L. Breiman, Random Forests, Machine Learning 45, 2001, section 10, for
    permutation; in blocks because neighbouring samples are alike.

    Example:
        print(jnx.evaluation.relevance(network, data))
    """
    choice(how, ("mean", "permuted"), "how")
    if how == "permuted" and key is None:
        raise SpecError("a permutation needs a key: key=jax.random.key(0)", field="key")
    data = match_records(network, data)
    length = _block(data, block)
    base = simulate(network, data).value
    spread = _deviation(network, data)
    without, moved = [], []
    for i in range(len(network.channels.inputs)):
        places = None
        if key is not None and how == "permuted":
            places = _permute_blocks(data.samples, length, jax.random.fold_in(key, i))
        run = simulate(network, _withheld(data, i, places)).value
        without.append(_errors(network, data, run))
        moved.append(_moves(base, run) / spread)
    return Relevance(
        network.output_channels,
        network.channels.inputs,
        _errors(network, data, base),
        np.array(without).reshape(-1, len(spread)),
        np.array(moved).reshape(-1, len(spread)),
        how,
    )


def _block(data: Dataset, block: float | int | None) -> int:
    """Samples of a block."""
    if block is None:
        return max(data.samples // DEFAULT_BLOCKS, 1)
    if not block >= data.sample_time:
        raise SpecError(
            f"block is a time of at least one sample ({data.sample_time:g} s), got "
            f"{block}",
            field="block",
        )
    return round(block / data.sample_time)


def _permute_blocks(samples: int, length: int, key: Array) -> np.ndarray:
    """The places from which each sample is taken: blocks in another order."""
    starts = np.arange(0, samples, length)
    order = np.asarray(jax.random.permutation(key, len(starts)))
    blocks = [np.arange(s, min(s + length, samples)) for s in starts[order].tolist()]
    return np.concatenate(blocks)


def _withheld(data: Dataset, i: int, places: np.ndarray | None) -> Dataset:
    """The data with input i at its mean, or taken from other places."""
    column = np.concatenate([r.u[:, i] for r in data])
    valid = np.concatenate([r.valid[:, i] for r in data])
    if places is None:
        size = float(np.max(np.abs(column))) or 1.0
        told = np.full_like(column, size * np.mean(column[valid] / size))
    else:
        told = column[places]
    ends = np.cumsum([len(r) for r in data])[:-1]
    records = []
    for record, own in zip(data, np.split(told, ends), strict=True):
        u = record.u.copy()
        u[:, i] = own
        records.append(dataclasses.replace(record, u=u))
    return dataclasses.replace(data, records=tuple(records))


def _errors(
    network: Network, data: Dataset, run: Trajectories
) -> Float[np.ndarray, " outputs"]:
    found = []
    for samples in collect(data, network.output_channels, run):
        if any(one.diverged for one in samples):
            found.append(np.inf)
            continue
        parts = [(s.measured, s.predicted, s.scored) for s in samples]
        found.append(float(nrmse(*map(np.concatenate, zip(*parts, strict=True)))[0]))
    return np.array(found)


def _deviation(network: Network, data: Dataset) -> Float[np.ndarray, " outputs"]:
    """Standard deviation of every modelled output; one where it is constant."""
    inputs, found = len(data.channels.inputs), []
    for o in network.modelled:
        y = np.concatenate([r.y[r.valid[:, inputs + o], o] for r in data])
        found.append(float(np.std(y)) if len(y) else 0.0)
    return np.where(np.array(found) > 0, found, 1.0)


def _moves(base: Trajectories, run: Trajectories) -> Float[np.ndarray, " outputs"]:
    """Root mean square of the difference of two runs where they are scored."""
    apart = [
        np.where(scored, one - two, 0.0)
        for one, two, scored in zip(base.outputs, run.outputs, base.scored, strict=True)
    ]
    count = np.concatenate(base.scored).sum(axis=0)
    square = np.sum(np.concatenate(apart) ** 2, axis=0)
    return np.sqrt(square / np.maximum(count, 1))
