"""A sweep of identifications as work for the run folder."""

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxnarx.argument_checks import guard_fields
from jaxnarx.data import Fleet
from jaxnarx.deprecation import old_method
from jaxnarx.errors import SpecError
from jaxnarx.identification import joint_pool
from jaxnarx.models import Network
from jaxnarx.partition import scheduling_table
from jaxnarx.regressors import Pool
from jaxnarx.settings import Identification, replace_at, to_dict
from jaxnarx.sweep.cases import Case, setting_label
from jaxnarx.sweep.identify.engine_data import (
    PreparedMember,
    make_blank,
    prepare,
    stack_lanes,
)
from jaxnarx.sweep.identify.program import identify_lanes
from jaxnarx.sweep.identify.rows import Row, empty_row, make_row
from jaxnarx.sweep.identify.settings import (
    Settings,
    Shape,
    make_settings,
    shapes,
    spare,
)
from jaxnarx.sweep.identify.shared_tables import Frame, make_frame
from jaxnarx.sweep.identify.verbs import run_member

FITS_PER_CALL = 16
"""Fits in one call of the program."""
KEPT_MEMBERS = 64
"""PreparedMember members that are kept for further cases."""
MADE_ATTRIBUTES = (
    "pool",
    "methods",
    "shapes",
    "frames",
    "settings",
    "prepared",
    "labels",
)


@guard_fields
@dataclasses.dataclass(frozen=True, eq=False)
class IdentificationWork:
    """Every engine of a fleet under every case.

    A case says what differs from `method`, by path: `{"refine.ridge": 1e-4}`. Forward
    selection, the partitions that grow or are placed, and Levenberg-Marquardt are one
    compiled program for all engines and for all cases that differ only in numbers
    (`jaxnarx.sweep.identify.settings.TRACED`, or in lags and degree of the pool), with
    the results of `identify`; but that `PredictionError` is judged by the free run
    here. Everything else goes by the verbs, one member after the other. A call of the
    program has `lanes` fits, the last one filled up, `at_once` of them side by side: on
    a CPU one after the other is the fastest.
    """

    fleet: Fleet
    method: Identification
    cases: Sequence[Case] = ({},)
    _: dataclasses.KW_ONLY
    lanes: int = FITS_PER_CALL
    at_once: int = 1

    def __post_init__(self):
        object.__setattr__(self, "cases", tuple(dict(c) for c in self.cases))
        if not self.cases:
            raise SpecError("a sweep needs at least one case", field="cases")
        for field in ("lanes", "at_once"):
            value = getattr(self, field)
            if value < 1:
                raise SpecError(f"{field} must be at least 1, got {value}", field=field)
        # what does not fit is said now, not by every member
        if len(self.pool.outputs) != 1:
            raise SpecError(
                "a sweep identifies one output; name it, with "
                "Polynomial(outputs=['...'])",
                field="outputs",
            )
        for method in self.methods:
            scheduling_table(self.pool, _scheduling_names(method))

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in MADE_ATTRIBUTES}

    @property
    def members(self) -> list[dict[str, Any]]:
        """Engine and swept settings of every fit: all cases of the first engine, and so
        on."""
        return self.labels

    @functools.cached_property
    def labels(self) -> list[dict[str, Any]]:
        """The same, made once."""
        swept = dict.fromkeys(path for case in self.cases for path in case)
        labels = [
            {path: setting_label(m, path) for path in swept} for m in self.methods
        ]
        return [
            {"engine": name, "case": n} | label
            for name in self.fleet.names
            for n, label in enumerate(labels)
        ]

    @functools.cached_property
    def methods(self) -> list[Identification]:
        """The settings of every case."""
        return [replace_at(self.method, case) for case in self.cases]

    @functools.cached_property
    def pool(self) -> Pool:
        """The candidate terms of all cases."""
        return joint_pool([m.pool for m in self.methods], self.fleet.channels)

    @functools.cached_property
    def shapes(self) -> list[Shape | None]:
        """The program of every case, None where the verbs do it."""
        return shapes(self.methods)

    @functools.cached_property
    def frames(self) -> dict[Shape, Frame]:
        """The tables that all fits of a program share."""
        known = {shape for shape in self.shapes if shape is not None}
        return {shape: make_frame(shape, self.pool) for shape in known}

    @functools.cached_property
    def settings(self) -> list[Settings | None]:
        """The arrays that the programs take of every case."""
        dtype = self.fleet.train.signals.dtype
        return [
            None if shape is None else make_settings(method, self.pool, dtype)
            for method, shape in zip(self.methods, self.shapes, strict=True)
        ]

    @functools.cached_property
    def prepared(self) -> Callable[[int, tuple[str, ...]], PreparedMember]:
        """One engine's records as the program takes them; the last ones are kept."""
        most = max(getattr(m.select, "max_terms", 1) for m in self.methods)

        @functools.cache
        def blank(scheduling: tuple[str, ...]) -> Network:
            return make_blank(self.fleet, self.pool, scheduling)

        def make(engine: int, scheduling: tuple[str, ...]) -> PreparedMember:
            # Where there is an accelerator, nothing of this has to go there and back.
            with jax.default_device(jax.local_devices(backend="cpu")[0]):
                own = blank(scheduling)
                return prepare(self.fleet, engine, self.pool, own, most)

        return functools.lru_cache(maxsize=max(KEPT_MEMBERS, self.lanes))(make)

    def prepare_case(self, engine: int, case: int) -> PreparedMember:
        """One engine's records for a case."""
        return self.prepared(engine, _scheduling_names(self.methods[case]))

    prepared_for = old_method("prepared_for", "prepare_case")

    def describe(self) -> dict[str, Any]:
        """Settings, cases, and digests of the data and the pool."""
        pool = self.pool
        table = hashlib.sha256(np.ascontiguousarray(pool.factor, np.int64).tobytes())
        table.update(repr((pool.variables, pool.outputs)).encode())
        return {
            "kind": "identification",
            "method": _to_json(to_dict(self.method)),
            "cases": [_to_json(case) for case in self.cases],
            "pool": {"terms": len(pool), "sha256": table.hexdigest()},
            "fleet": {"engines": len(self.fleet), "sha256": self.fleet.digest()},
            "lanes": self.lanes,
            "at_once": self.at_once,
        }

    def run(self, indices: Sequence[int]) -> list[Row]:
        """One row per index, see `make_row`; engines that cannot be used are rows
        too."""
        pairs = [divmod(int(n), len(self.cases)) for n in indices]
        rows: dict[int, Row] = {}
        groups: dict[Shape, list[int]] = {}
        for place, (engine, case) in enumerate(pairs):
            found, shape = self.prepare_case(engine, case), self.shapes[case]
            if found.member is None:
                rows[place] = empty_row(self.fleet, found)
            elif shape is None:
                own = self.methods[case], self.pool, found.member
                rows[place] = run_member(self.fleet, engine, *own)
            else:
                groups.setdefault(shape, []).append(place)
        for shape, good in groups.items():
            for first in range(0, len(good), self.lanes):
                part = good[first : first + self.lanes]
                made = self._call(shape, [pairs[place] for place in part])
                rows |= dict(zip(part, made, strict=True))
        return [rows[place] for place in range(len(pairs))]

    def _call(self, shape: Shape, pairs: list[tuple[int, int]]) -> list[Row]:
        """One call of a program, filled up with the shortest fits there are."""
        members = [self.prepare_case(*pair).member for pair in pairs]
        settings = [self.settings[case] for _, case in pairs]
        more = self.lanes - len(pairs)
        members += members[-1:] * more
        settings += [spare(s) for s in settings[-1:] if s is not None] * more
        outcome = identify_lanes(
            self.frames[shape],
            stack_lanes(members),
            stack_lanes(settings),
            at_once=self.at_once,
        )
        host = jax.tree.map(np.asarray, jax.device_get(outcome))
        return [
            make_row(self.pool, jax.tree.map(lambda a, n=n: a[n], host), member.network)
            for n, member in enumerate(members[: len(pairs)])
            if member is not None
        ]


def _scheduling_names(method: Identification) -> tuple[str, ...]:
    return tuple(getattr(method.grow, "scheduling", ()))


def _to_json(value: Any) -> Any:
    """Values as JSON gives them back; arrays by their digest, the rest by name."""
    if isinstance(value, dict):
        return {str(key): _to_json(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_to_json(item) for item in value]
    if isinstance(value, str | int | float | None):
        return value
    if isinstance(value, np.ndarray | jax.Array):
        return hashlib.sha256(np.asarray(value).tobytes()).hexdigest()
    kind = type(value)
    if dataclasses.is_dataclass(kind):
        own = {f.name: getattr(value, f.name) for f in dataclasses.fields(kind)}
        return {"class": kind.__qualname__} | _to_json(own)
    return getattr(value, "__qualname__", kind.__qualname__)
