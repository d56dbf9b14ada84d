"""Numbers of a network as exports hold them, in tables, and the way back.

A calibrator changes numbers of the tables. `write` of every table is the inverse of its
`read` and stands beside it; it touches what has changed alone, so that a table that
comes back as it went leaves every digit of the network as it was.

| table | entry | field of the network |
|---|---|---|
| `theta` | c | coefficient c, of scaled signals |
| `scheduling` | gain/s; o/s | span s and offset o: z = (x/gain) (gain/s) - o/s |
| `centre`, `low`, `high`, `border` | c | the same |
| `narrowness` of Gaussians | exp(-w) | log width w |
| `steepness` of compact curves | 1/2 exp(-m) | log margin m |
| `steepness` of log-sigmoids | exp(k) | log steepness k |
| `gate` of a tree | exp(k) d/|d| | log steepness k, direction d (of length one) |
| `gate_border` of a tree | exp(k) c | border c |
"""

import abc
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.exporters.names import identifiers
from jaxnarx.models import (
    LEAST_LOG_WIDTH,
    AdditiveGates,
    Boxes,
    Compact,
    GateProducts,
    Gaussians,
    LogSigmoids,
    Network,
    OutputModel,
    SigmoidTree,
)
from jaxnarx.regressors import term_name, variable_names

Values = Float[np.ndarray, "rows *columns"]


class OutputAt(NamedTuple):
    """An output of a network, with what all its tables need."""

    network: Network
    output: int

    @property
    def model(self) -> OutputModel:
        """Its local models and their partition."""
        return self.network.models[self.output]

    @property
    def active(self) -> np.ndarray:
        """Places of the local models in use."""
        return np.flatnonzero(np.asarray(self.model.active))


class AbstractTable(abc.ABC):
    """A kind of table: `read` from a network, and `write` back where it has changed.

    `write` gives the output's model; it raises `ValueError` with what is wrong.
    """

    about: str

    def count_stored(self, at: OutputAt) -> int:
        """The number of entries that have to be stored."""
        return self.read(at).size

    @abc.abstractmethod
    def read(self, at: OutputAt) -> Values:
        """The numbers of the table."""

    @abc.abstractmethod
    def write(
        self, at: OutputAt, values: Values, changed: Bool[np.ndarray, "rows *columns"]
    ) -> OutputModel:
        """The model with other numbers where they have `changed`."""


def _positive(values: Values, changed: np.ndarray) -> None:
    if np.any(changed & (values <= 0)):
        raise ValueError("every number must be above zero")


def _cast_like(value: np.ndarray, array: Any) -> jax.Array:
    return jax.device_put(value.astype(np.asarray(array).dtype))


@dataclasses.dataclass(frozen=True)
class Field(AbstractTable):
    """A field of a validity function, number by number through a function and back;
    `rows` tells which of its rows from the active models."""

    field: str
    about: str
    out: Callable[[np.ndarray], np.ndarray] | None = None
    back: Callable[[np.ndarray], np.ndarray] | None = None
    rows: Callable[[np.ndarray], np.ndarray] | None = None

    def _rows(self, at: OutputAt) -> np.ndarray:
        return at.active if self.rows is None else self.rows(at.active)

    def read(self, at: OutputAt) -> Values:
        """See `AbstractTable`."""
        whole = np.atleast_1d(np.asarray(getattr(at.model.validity, self.field), float))
        values = whole[self._rows(at)]
        return values if self.out is None else self.out(values)

    def write(
        self, at: OutputAt, values: Values, changed: Bool[np.ndarray, "rows *columns"]
    ) -> OutputModel:
        """See `AbstractTable`."""
        if self.back is not None:
            _positive(values, changed)
            with np.errstate(all="ignore"):  # of entries that have not changed
                values = self.back(values)
        validity = at.model.validity
        old = getattr(validity, self.field)
        new, rows = np.atleast_1d(np.array(old, float)), self._rows(at)
        new[rows] = np.where(changed, values, new[rows])
        new = _cast_like(new.reshape(np.shape(old)), old)
        validity = dataclasses.replace(validity, **{self.field: new})
        return dataclasses.replace(at.model, validity=validity)


def _gates(at: OutputAt) -> tuple[SigmoidTree, np.ndarray]:
    """A tree, and which of its gates are on a path."""
    tree = at.model.validity
    assert isinstance(tree, SigmoidTree)
    path = np.asarray(tree.path)[at.active]
    return tree, np.flatnonzero(np.any(path != 0, axis=0))


def _replace_tree(at: OutputAt, tree: SigmoidTree, **fields: np.ndarray) -> OutputModel:
    new = {name: _cast_like(v, getattr(tree, name)) for name, v in fields.items()}
    validity = dataclasses.replace(tree, **new)
    return dataclasses.replace(at.model, validity=validity)


@dataclasses.dataclass(frozen=True)
class Gates(AbstractTable):
    """Directions of the gates of a tree, times steepness."""

    about: str = "directions of the gates, times steepness"

    def count_stored(self, at: OutputAt) -> int:
        """A variable that a gate does not look at has none."""
        return int(np.count_nonzero(self.read(at)))

    def read(self, at: OutputAt) -> Values:
        """See `AbstractTable`."""
        tree, gates = _gates(at)
        steep = np.exp(np.asarray(tree.log_steepness, float))[gates]
        return tree.unit(np).astype(float)[gates] * steep[:, None]

    def write(
        self, at: OutputAt, values: Values, changed: Bool[np.ndarray, "rows *columns"]
    ) -> OutputModel:
        """A gate that turns keeps its entry of `gate_border`."""
        tree, gates = _gates(at)
        turned = np.any(changed, axis=1)
        steep = np.sqrt(np.sum(values[turned] ** 2, axis=1))
        if np.any(steep == 0):
            raise ValueError("a gate has no direction")
        direction, border, log_steepness = (
            np.array(a, float)
            for a in (tree.direction, tree.border, tree.log_steepness)
        )
        at_gate = gates[turned]
        border[at_gate] *= np.exp(log_steepness[at_gate]) / steep
        direction[at_gate] = values[turned] / steep[:, None]
        log_steepness[at_gate] = np.log(steep)
        fields = dict(direction=direction, border=border, log_steepness=log_steepness)
        return _replace_tree(at, tree, **fields)


@dataclasses.dataclass(frozen=True)
class GateBorders(AbstractTable):
    """Borders of the gates of a tree, times steepness."""

    about: str = "borders of the gates, times steepness"

    def read(self, at: OutputAt) -> Values:
        """See `AbstractTable`."""
        tree, gates = _gates(at)
        steep = np.exp(np.asarray(tree.log_steepness, float))
        return (np.asarray(tree.border, float) * steep)[gates]

    def write(
        self, at: OutputAt, values: Values, changed: Bool[np.ndarray, "rows *columns"]
    ) -> OutputModel:
        """See `AbstractTable`."""
        tree, gates = _gates(at)
        border = np.array(tree.border, float)
        steep = np.exp(np.asarray(tree.log_steepness, float))[gates]
        border[gates] = np.where(changed, values / steep, border[gates])
        return _replace_tree(at, tree, border=border)


@dataclasses.dataclass(frozen=True)
class Scaling(AbstractTable):
    """The scaling of scheduling variables to 0 to 1: z = (x/gain) first - second
    row."""

    about: str = (
        "scaling of the scheduling: factors of scaled signals, then what is subtracted"
    )

    def _parts(self, at: OutputAt) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        signals = [s for s, _ in at.model.scheduling]
        gain = np.asarray(at.network.gain, float)[signals]
        offset, span = (np.array(a, float) for a in (at.model.offset, at.model.span))
        return gain, offset, span

    def read(self, at: OutputAt) -> Values:
        """See `AbstractTable`."""
        gain, offset, span = self._parts(at)
        return np.stack([gain / span, offset / span])

    def write(
        self, at: OutputAt, values: Values, changed: Bool[np.ndarray, "rows *columns"]
    ) -> OutputModel:
        """A variable whose factor changes keeps what is subtracted."""
        gain, offset, span = self._parts(at)
        _positive(values[0], changed[0])
        new = np.where(changed[0], gain / values[0], span)
        moved = changed.any(axis=0)
        offset = np.where(moved, values[1] * new, offset)
        return dataclasses.replace(
            at.model,
            offset=_cast_like(offset, at.model.offset),
            span=_cast_like(new, at.model.span),
        )


@dataclasses.dataclass(frozen=True)
class Coefficients(AbstractTable):
    """Coefficients by local model and by term that any of them has."""

    about: str = (
        "coefficients, a row for every local model, a column for every term, of scaled "
        "signals"
    )

    def columns(self, at: OutputAt) -> np.ndarray:
        """Which of the distinct terms have a column."""
        dense = np.asarray(at.model.local.dense(), float)[at.active]
        return np.flatnonzero(np.any(dense != 0, axis=0))

    def read(self, at: OutputAt) -> Values:
        """See `AbstractTable`."""
        dense = np.asarray(at.model.local.dense(), float)[at.active]
        return dense[:, self.columns(at)]

    def write(
        self, at: OutputAt, values: Values, changed: Bool[np.ndarray, "rows *columns"]
    ) -> OutputModel:
        """Change the first slot where several of a local model are the same term."""
        local, terms = at.model.local, self.columns(at)
        index, used = np.asarray(local.index), np.asarray(local.used)
        coefficient = np.array(local.coefficient, float)
        for row, column in np.argwhere(changed):
            m, term = at.active[row], terms[column]
            slots = np.flatnonzero(used[m] & (index[m] == term))
            if not len(slots):
                raise ValueError(
                    f"row {row + 1}, column {column + 1}: the local model has no such "
                    "term; leave it at zero"
                )
            first, *others = slots
            rest = coefficient[m, others].sum()
            coefficient[m, first] = values[row, column] - rest
        new = _cast_like(coefficient, local.coefficient)
        local = dataclasses.replace(local, coefficient=new)
        return dataclasses.replace(at.model, local=local)


def _rows(what: str) -> str:
    return f"{what}, a row for every local model or gate, of scheduling from 0 to 1"


def _gates_behind(active: np.ndarray) -> np.ndarray:
    """The gates of the active local models behind the first."""
    return active[active > 0] - 1


_BOX_FIELDS = {
    what: Field(what, _rows(f"{what} borders of the boxes")) for what in ("low", "high")
}
VALIDITIES: dict[type, dict[str, AbstractTable]] = {
    Gaussians: {
        "centre": Field("centre", _rows("centres")),
        "narrowness": Field(
            "log_width",
            _rows("inverse widths of Gaussians"),
            lambda w: np.exp(-np.maximum(w, LEAST_LOG_WIDTH)),
            lambda x: -np.log(x),
        ),
    },
    Boxes: {**_BOX_FIELDS},
    Compact: {
        **_BOX_FIELDS,
        "steepness": Field(
            "log_margin",
            _rows("steepness of the borders"),
            lambda m: 0.5 / np.exp(m),
            lambda x: np.log(0.5 / x),
        ),
    },
    LogSigmoids: {
        # borders of models that are not active do not count
        "border": Field("border", _rows("borders"), rows=_gates_behind),
        "steepness": Field(
            "log_steepness",
            "steepness of the sigmoids",
            np.exp,
            np.log,
            lambda a: np.arange(1),
        ),
    },
    SigmoidTree: {"gate": Gates(), "gate_border": GateBorders()},
    GateProducts: {"gate": Gates(), "gate_border": GateBorders()},
    AdditiveGates: {
        "gate": Field("direction", Gates.about, rows=_gates_behind),
        "gate_border": Field("border", GateBorders.about, rows=_gates_behind),
    },
}
"""Tables of every validity function that is known here, in the order of writing."""
THETA_TABLE, SCHEDULING_TABLE = Coefficients(), Scaling()


def has_regions(at: OutputAt) -> bool:
    """Whether the operating space is divided at all."""
    return len(at.active) > 1 or isinstance(at.model.validity, LogSigmoids)


def tables_at(at: OutputAt) -> Mapping[str, AbstractTable]:
    """The tables of an output by the first part of their names."""
    if not has_regions(at):
        return {"theta": THETA_TABLE}
    kind = VALIDITIES.get(type(at.model.validity), {})
    return {"scheduling": SCHEDULING_TABLE, **kind, "theta": THETA_TABLE}


def count_stored_for_weights(network: Network, output: int) -> int:
    """The number of entries that an output's validity functions are made of."""
    at = OutputAt(network, output)
    kind = VALIDITIES.get(type(at.model.validity), {}) if has_regions(at) else {}
    return sum(table.count_stored(at) for table in kind.values())


def column_names(at: OutputAt, kind: str, values: Values) -> list[str]:
    """The names of a table's columns: terms, or scheduling variables."""
    if kind == "theta":
        rows = np.asarray(at.model.local.factor)[THETA_TABLE.columns(at)].tolist()
        return [term_name(at.network.variable_names, row) for row in rows]
    if values.ndim == 2:
        return variable_names(at.network.channels, at.model.scheduling)
    return []


def network_tables(network: Network) -> dict[str, tuple[AbstractTable, int]]:
    """All tables of a network, and whose they are: `theta_NOx` and the others."""
    words = identifiers(network.computed_names)
    return {
        f"{kind}_{words[o]}": (table, o)
        for o in range(len(network.models))
        for kind, table in tables_at(OutputAt(network, o)).items()
    }
