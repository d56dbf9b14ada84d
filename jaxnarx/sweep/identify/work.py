"""A sweep of identifications as work for the run folder."""

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from jaxnarx.errors import SpecError
from jaxnarx.methods import Case, Identification
from jaxnarx.regressors import Pool
from jaxnarx.sweep.fleet import Fleet
from jaxnarx.sweep.identify.frame import Frame, make_frame, make_pool
from jaxnarx.sweep.identify.member import Prepared, prepare, stacked
from jaxnarx.sweep.identify.program import identify_lanes
from jaxnarx.sweep.identify.rows import Row, empty_row, row_of
from jaxnarx.sweep.identify.settings import make_settings, within
from jaxnarx.sweep.identify.verbs import require_verbs, run_member

LANES = 16
"""Fits in one call of the program."""
KEPT = 64
"""Prepared members that are kept for further cases."""
MADE = ("pool_of_all", "frame", "prepared", "labels")


@dataclasses.dataclass(frozen=True, eq=False)
class IdentificationWork:
    """Every engine of a fleet under every case.

    `pool` takes the place of the polynomial pool that `method` describes. A call of the
    program has `lanes` fits, the last one filled up, `at_once` of them side by side: on
    a CPU one after the other is the fastest.
    """

    fleet: Fleet
    method: Identification
    cases: Sequence[Case] = (Case(),)
    _: dataclasses.KW_ONLY
    pool: Pool | None = None
    lanes: int = LANES
    at_once: int = 1

    def __post_init__(self):
        object.__setattr__(self, "cases", tuple(self.cases))
        if not self.cases:
            raise SpecError("a sweep needs at least one case", field="cases")
        for field in ("lanes", "at_once"):
            value = getattr(self, field)
            if value < 1:
                raise SpecError(f"{field} must be at least 1, got {value}", field=field)
        _ = self.frame  # what does not fit is said now, not by every member
        for case in self.cases:
            make_settings(case, self.method, self.pool_of_all, np.dtype(float))
            if not self.method.fused:
                require_verbs(self.method, case)

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k not in MADE}

    @property
    def members(self) -> list[dict[str, Any]]:
        """Engine and settings of every fit: all cases of the first engine, and so on.

        Capacities stand in place of None.
        """
        return self.labels

    @functools.cached_property
    def labels(self) -> list[dict[str, Any]]:
        """The same, made once."""
        labels = [within(case, self.method).labels() for case in self.cases]
        return [
            {"engine": name, "case": n} | label
            for name in self.fleet.names
            for n, label in enumerate(labels)
        ]

    @functools.cached_property
    def pool_of_all(self) -> Pool:
        """The candidate terms."""
        if self.pool is None:
            return make_pool(self.method, self.fleet.channels)
        if self.pool.channels != self.fleet.channels:
            raise SpecError(
                "the pool belongs to other channels than the fleet; make it with "
                "polynomial_pool(fleet.channels, ...)",
                field="pool",
            )
        return self.pool

    @functools.cached_property
    def frame(self) -> Frame:
        """What all fits share."""
        return make_frame(self.method, self.pool_of_all)

    @functools.cached_property
    def prepared(self) -> Callable[[int], Prepared]:
        """One engine's records as the program takes them; the last ones are kept."""

        def make(engine: int) -> Prepared:
            return prepare(self.fleet, engine, self.method, self.pool_of_all)

        return functools.lru_cache(maxsize=KEPT)(make)

    def describe(self) -> dict[str, Any]:
        """Settings, cases, and digests of the data and the pool."""
        pool = self.pool_of_all
        table = hashlib.sha256(np.ascontiguousarray(pool.factor, np.int64).tobytes())
        table.update(repr((pool.variables, pool.outputs)).encode())
        return {
            "kind": "identification",
            "method": {
                f.name: _plain(getattr(self.method, f.name))
                for f in dataclasses.fields(self.method)
            },
            "cases": [_plain(dataclasses.asdict(case)) for case in self.cases],
            "pool": {"terms": len(pool), "sha256": table.hexdigest()},
            "fleet": {"engines": len(self.fleet), "sha256": self.fleet.digest()},
            "lanes": self.lanes,
            "at_once": self.at_once,
        }

    def run(self, indices: Sequence[int]) -> list[Row]:
        """One row per index, see `row_of`; engines that cannot be used are rows too."""
        pairs = [divmod(int(n), len(self.cases)) for n in indices]
        rows: dict[int, Row] = {}
        good = []
        for place, (engine, _) in enumerate(pairs):
            if self.prepared(engine).member is None:
                rows[place] = empty_row(self.fleet, self.prepared(engine))
            else:
                good.append(place)
        for first in range(0, len(good), self.lanes):
            part = good[first : first + self.lanes]
            found = self._call([pairs[place] for place in part])
            rows |= dict(zip(part, found, strict=True))
        return [rows[place] for place in range(len(pairs))]

    def _by_verbs(self, engine: int, case: Case) -> Row:
        """What the program does not know."""
        member = self.prepared(engine).member
        assert member is not None
        both = self.method, case, self.pool_of_all, member
        return run_member(self.fleet, engine, *both)

    def _call(self, pairs: list[tuple[int, int]]) -> list[Row]:
        """One call of the program, filled up with the shortest fits there are."""
        pool, dtype = self.pool_of_all, self.fleet.train.signals.dtype
        if not self.method.fused:
            return [self._by_verbs(engine, self.cases[case]) for engine, case in pairs]
        cases = [self.cases[case] for _, case in pairs]
        engines = [engine for engine, _ in pairs]
        spare = self.lanes - len(pairs)
        cases += [Case(terms=1, models=1, steps=0, train="none")] * spare
        engines += engines[-1:] * spare

        def member(n: int) -> Any:
            return self.prepared(engines[n]).member

        members = stacked([member(n) for n in range(self.lanes)])
        settings = stacked([make_settings(c, self.method, pool, dtype) for c in cases])
        outcome = identify_lanes(self.frame, members, settings, at_once=self.at_once)
        host = jax.tree.map(np.asarray, jax.device_get(outcome))
        return [
            row_of(pool, jax.tree.map(lambda a, n=n: a[n], host), member(n).network)
            for n in range(len(pairs))
        ]


def _plain(value: Any) -> Any:
    """Values as JSON gives them back; arrays by their digest, the rest by name."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, str | int | float | None):
        return value
    if isinstance(value, np.ndarray | jax.Array):
        return hashlib.sha256(np.asarray(value).tobytes()).hexdigest()
    kind = type(value)
    if dataclasses.is_dataclass(kind):
        own = {f.name: getattr(value, f.name) for f in dataclasses.fields(kind)}
        return {"class": kind.__qualname__} | _plain(own)
    return getattr(value, "__qualname__", kind.__qualname__)
