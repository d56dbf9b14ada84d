"""Error against the number of terms: what every size of a selection is worth."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxnarx.argument_checks import guard_arguments
from jaxnarx.data import Channel, Dataset
from jaxnarx.errors import SpecError
from jaxnarx.evaluation._cost import cost
from jaxnarx.evaluation.rows import collect, score
from jaxnarx.formatting import align_columns, page
from jaxnarx.models import Network
from jaxnarx.regressors import term_name
from jaxnarx.simulation import predict, simulate


@dataclasses.dataclass(frozen=True, eq=False)
class SizeErrors:
    """NRMSE of one output by the number of its terms, in order of choice.

    `free_run` and `one_step` hold by part an error for every one of `sizes`, infinite
    where the free run diverges; `operations` are those of one sample. `chosen` is the
    size of the selection.
    """

    output: Channel
    sizes: Int[np.ndarray, " sizes"]
    operations: Int[np.ndarray, " sizes"]
    one_step: Mapping[str, Float[np.ndarray, " sizes"]]
    free_run: Mapping[str, Float[np.ndarray, " sizes"]]
    chosen: int

    def best(self, part: str) -> int:
        """The size with the least free-run error on that part."""
        return int(self.sizes[np.argmin(self.free_run[part])])

    def __str__(self) -> str:
        heads = [f"free run, {part}" for part in self.free_run]
        rows = [("terms", "operations", *heads)]
        for n, size in enumerate(self.sizes.tolist()):
            errors = [f"{values[n]:.4g}" for values in self.free_run.values()]
            mark = f"{size} *" if size == self.chosen else str(size)
            rows.append((mark, str(int(self.operations[n])), *errors))
        return "\n".join([f"{self.output.name}: NRMSE by size", *align_columns(rows)])

    _repr_html_ = page


@guard_arguments
def errors_by_size(
    selection: Any, data: Dataset | Mapping[str, Dataset]
) -> tuple[SizeErrors, ...]:
    """Free-run and one-step error of the first terms of a selection, size by size.

    Every size has the least-squares coefficients it had when it was chosen. All sizes
    are one program: terms that are left out have no weight.

    Args:
        selection: A `Selection`; the terms of every output in order of choice.
        data: One dataset, or several by the name of their part; the feedback bounds are
            those of the first.

    Returns:
        One table for every output. Where there are several outputs, all have the first
        n terms, those with fewer keep theirs.

    Example:
        chosen = jnx.select(pool, data, jnx.ForwardOLS(max_terms=3)).value
        (found,) = jnx.evaluation.errors_by_size(chosen, {"train": data})
        print(found)
    """
    parts = dict(data) if isinstance(data, Mapping) else {"data": data}
    if not parts:
        raise SpecError("there is no data", field="data")
    # What chooses and grows needs the metrics of this room: not before it is asked.
    from jaxnarx.partition import grow
    from jaxnarx.settings import Global

    whole = grow(selection, next(iter(parts.values())), Global()).value
    counts = [selection.size(o) for o in range(len(selection.output_names))]
    sizes = np.arange(1, max(counts) + 1)
    networks = [_truncate(whole, selection, int(n)) for n in sizes]
    prices = [cost(network) for network in networks]
    scores = {
        (part, mode): [_nrmse(n, part_data, mode) for n in networks]
        for part, part_data in parts.items()
        for mode in ("one step", "free run")
    }
    found = []
    for o, channel in enumerate(whole.output_channels):
        own = sizes <= counts[o]
        operations = [p.outputs[channel.name].operations for p in prices]
        one, free = (
            {p: np.array(scores[p, mode])[own, o] for p in parts}
            for mode in ("one step", "free run")
        )
        arrays = sizes[own], np.array(operations)[own]
        found.append(SizeErrors(channel, *arrays, one, free, counts[o]))
    return tuple(found)


def _truncate(network: Network, selection: Any, size: int) -> Network:
    """The network with the first `size` terms, in the shapes of the whole one."""
    models = []
    for o, model in enumerate(network.models):
        names = selection.names_of(network.output_names[o])
        count = min(size, len(names))
        values = selection.nested[o, count - 1]
        scale = _scale(network, selection, o)
        local = model.local
        rows = np.asarray(local.factor)[np.asarray(local.index)[0]]
        variables = network.variable_names
        place = [
            names.index(term_name(variables, row)) if used else len(names)
            for row, used in zip(
                rows.tolist(), np.asarray(local.used)[0].tolist(), strict=True
            )
        ]
        used = np.array([[p < count for p in place]])
        taken = [values[p] * scale[p] if p < count else 0.0 for p in place]
        coefficient = jnp.asarray(np.array([taken]), local.coefficient.dtype)
        local = eqx.tree_at(
            lambda one: (one.used, one.coefficient),
            local,
            (jnp.asarray(used), coefficient),
        )
        models.append(eqx.tree_at(lambda one: one.local, model, local))
    return eqx.tree_at(lambda one: one.models, network, tuple(models))


def _scale(network: Network, selection: Any, o: int) -> Float[np.ndarray, " terms"]:
    """The factors that turn coefficients for the selection's gains into those for the
    network's.

    A term of signals scaled by g has the coefficient theta / g_y prod g.
    """
    pool = selection.pool
    ratio = np.asarray(network.gain, float) / np.asarray(selection.gain, float)
    signal = np.array([s for s, _ in pool.variables], int)
    by_variable = np.concatenate([[1.0], ratio[signal]])
    factors = np.asarray(pool.factor)[selection.terms(o)]
    return np.prod(by_variable[factors], axis=1) / ratio[network.signals[o]]


def _nrmse(network: Network, data: Dataset, mode: str) -> list[float]:
    run = predict(network, data) if mode == "one step" else simulate(network, data)
    found = collect(data, network.output_channels, run.value)
    rows = [
        score("", mode, channel, samples)[0]
        for channel, samples in zip(network.output_channels, found, strict=True)
    ]
    return [np.inf if row.nrmse is None else row.nrmse for row in rows]
