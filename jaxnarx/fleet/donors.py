"""Sums of all donors, in memory or in a folder, where a stopped call goes on.

    fleet.json         key: network, coefficients and names that the sums belong to
    pass0.npy ...      a row of numbers for every donor, NaN where it is not there yet

A file is mapped, not read: so memory does not grow with the number of donors.
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from jaxnarx.data import Dataset
from jaxnarx.errors import DataError, SpecError
from jaxnarx.files import write_whole
from jaxnarx.fleet.climb import Climb, climb
from jaxnarx.fleet.coefficients import FleetCoefficients
from jaxnarx.fleet.information import (
    Information,
    gather_information,
    parts_of,
    skip_begin,
)
from jaxnarx.models import Network
from jaxnarx.simulation import Prepared, prepare

KEY_FILE = "fleet.json"
CHUNK = 64
"""Donors whose sums are in one program."""

Donors = Mapping[str, Any]
"""Records of donors by name, each a `Dataset` or the `DataError` that there is none;
one is asked for when it is needed, so that a mapping which reads files holds one at a
time."""


@dataclasses.dataclass(frozen=True, eq=False)
class SumsShape:
    """Sizes of a donor's sums."""

    outputs: int
    params: int

    @property
    def row(self) -> int:
        """Numbers of a donor: where the sums are about, and the sums."""
        return self.params + self.outputs * (2 + self.params + self.params**2)

    def flat(
        self, at: Float[np.ndarray, " params"], information: Information
    ) -> Float[np.ndarray, " row"]:
        """Sums and their place as one row."""
        return np.concatenate([np.asarray(a).reshape(-1) for a in (at, *information)])

    def unflat(self, rows: Float[np.ndarray, "donors row"]) -> Information:
        """The sums of some rows."""
        p, o = self.params, self.outputs
        sizes = ((o,), (o, p), (o, p, p), (o,))
        edges = np.cumsum([int(np.prod(s)) for s in sizes])[:-1]
        parts = np.split(np.asarray(rows)[:, p:], edges, axis=1)
        pairs = zip(parts, sizes, strict=True)
        return Information(*(a.reshape(len(a), *s) for a, s in pairs))


@dataclasses.dataclass(frozen=True, eq=False)
class DonorTable:
    """A row of numbers for every donor; NaN where it is not there yet."""

    rows: Float[np.ndarray, "donors row"]

    @classmethod
    def begin(cls, folder: Path | None, name: str, donors: int, row: int):
        """An empty table, or the one that is in the folder."""
        if folder is None:
            return cls(np.full((donors, row), np.nan))
        path = folder / f"{name}.npy"
        if not path.exists():
            made = np.lib.format.open_memmap(
                path, mode="w+", dtype=np.float64, shape=(donors, row)
            )
            made[:] = np.nan
            made.flush()
        rows = np.lib.format.open_memmap(path, mode="r+")
        if rows.shape != (donors, row):
            raise SpecError(f"{path} holds other sums", field="folder")
        return cls(rows)

    def missing(self, n: int) -> bool:
        """Whether a donor is not there yet; its last number is written last."""
        return bool(np.isnan(self.rows[n, -1]))

    def put(self, n: int, row: np.ndarray) -> None:
        """Keep the row of a donor."""
        self.rows[n, :-1] = row[:-1]
        if isinstance(self.rows, np.memmap):
            self.rows.flush()
        self.rows[n, -1] = row[-1]


def open_folder(folder: Path | None, key: dict[str, Any]) -> None:
    """Begin a folder, or see that it belongs to the same donors and network."""
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / KEY_FILE
    if path.exists():
        there = json.loads(path.read_text())
        if there != key:
            changed = [k for k in key if there.get(k) != key[k]]
            raise SpecError(
                f"{folder} holds the sums of other {' and '.join(changed)}; take "
                "another folder",
                field="folder",
            )
    else:
        write_whole(path, json.dumps(key).encode())


def digest(network: Network) -> str:
    """A digest of all arrays of a network."""
    leaves = [np.asarray(a) for a in jax.tree.leaves(network)]
    return hashlib.sha256(b"".join(a.tobytes() for a in leaves)).hexdigest()


def gather_donors(
    donors: Donors,
    names: list[str],
    coefficients: FleetCoefficients,
    start: Float[np.ndarray, "donors params"],
    drawn: Climb | None,
    table: DonorTable,
    shape: SumsShape,
    skip: int,
    remark: dict[str, str],
    tell: Callable[[int], None],
) -> None:
    """Fill the table: sums of every donor about its start, or about the most probable
    coefficients near it where it is told what they are drawn from.

    A donor that cannot be run has zeros, and a remark.
    """
    for n, name in enumerate(names):
        if table.missing(n):
            row = np.zeros(shape.row)
            data = donors[name]
            require_records(name, data)
            try:
                runs = prepare_donor(coefficients.layout.base, data, skip)
                part = jax.device_put(parts_of(runs, ()))
                at = start[n]
                if drawn is not None:
                    at = climb(coefficients, runs, part, drawn, at)
                found = gather_information(coefficients, at, runs, part, 1)
                row = shape.flat(at, found.total())
                if not np.all(np.isfinite(row)):
                    raise DataError("the free run of the population's network diverges")
            except (DataError, SpecError) as error:
                row = np.zeros(shape.row)
                remark.setdefault(name, str(error))
            table.put(n, row)
        tell(n)


def require_records(name: str, data: Any) -> None:
    """SpecError where a donor is neither records nor the error that there are none."""
    if not isinstance(data, Dataset | DataError):
        raise SpecError(
            f"donor {name} is of type {type(data).__name__}, but must be a Dataset",
            field="donors",
        )


def prepare_donor(network: Network, data: Dataset | DataError, skip: int) -> Prepared:
    """The records of a donor as a network needs them, without their first samples; its
    error where it has none."""
    if isinstance(data, DataError):
        raise data
    return skip_begin(prepare(network, data), skip)


@dataclasses.dataclass(frozen=True, eq=False)
class Pass:
    """Sums of all donors, each about coefficients of its own."""

    table: DonorTable
    shape: SumsShape

    @property
    def at(self) -> Float[np.ndarray, "donors params"]:
        """What the sums are about."""
        return np.asarray(self.table.rows[:, : self.shape.params])

    def one(self, n: int) -> Information:
        """The sums of one donor."""
        rows = self.shape.unflat(self.table.rows[n : n + 1])
        return Information(*(np.asarray(a)[0] for a in rows))

    def chunks(self, weight: Float[np.ndarray, " donors"]) -> "Chunks":
        """Sums, places and weights, of some donors at a time."""
        return Chunks(self, weight)


class Chunks(Sequence):
    """The chunks of a pass, each read when it is asked for; zeros behind the last
    donor, so that one program serves all."""

    def __init__(self, one: Pass, weight: Float[np.ndarray, " donors"]):
        self.one, self.weight = one, weight

    def __len__(self) -> int:
        return -(-len(self.weight) // CHUNK)

    def __getitem__(self, number):
        if not 0 <= number < len(self):
            raise IndexError(number)
        rows = slice(number * CHUNK, (number + 1) * CHUNK)
        sums = self.one.shape.unflat(self.one.table.rows[rows])
        padded = Information(*(_pad(np.asarray(a)) for a in sums))
        return padded, _pad(self.one.at[rows]), _pad(self.weight[rows])


def _pad(a: np.ndarray) -> np.ndarray:
    return np.pad(a, [(0, CHUNK - len(a)), *((0, 0) for _ in a.shape[1:])])
