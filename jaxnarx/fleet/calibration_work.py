"""A sweep of calibrations as work for a run folder: engines by numbers of samples."""

import dataclasses
import functools
import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxnarx.argument_checks import guard_fields
from jaxnarx.data import Dataset, data_hash
from jaxnarx.errors import DataError, SpecError
from jaxnarx.fleet._calibrate import calibrate
from jaxnarx.fleet.prior import FleetPrior
from jaxnarx.models import Network
from jaxnarx.simulation import simulate
from jaxnarx.solution import Solution

Row = dict[str, Any]
FACTS = "distance", "expected", "probability", "learnt"


@guard_fields
@dataclasses.dataclass(frozen=True, eq=False)
class CalibrationWork:
    """Every engine calibrated from the first samples of its first record, so many each.

    `jaxnarx.sweep.run_sweep` computes it, in a folder that goes on. All numbers of
    samples of an engine are judged by the free run over the same samples: those behind
    the largest number, and all other records. Rows have, of every output, `way` and
    `weight` of the calibration, its `free_run` error and that of the population's mean,
    `as_is`, both NRMSE (infinite where the run diverges); and of the engine what
    `calibrate` tells of its `distance` from the fleet.
    """

    prior: FleetPrior
    engines: Mapping[str, Dataset | DataError]
    samples: Sequence[int] = (10, 20, 50, 100)

    def __post_init__(self):
        if not self.engines:
            raise SpecError("a sweep needs at least one engine", field="engines")
        rising = list(self.samples) == sorted(set(self.samples))
        if not self.samples or not rising or self.samples[0] < 1:
            raise SpecError(
                f"samples must rise from 1 or more, got {list(self.samples)}",
                field="samples",
            )

    @property
    def members(self) -> list[Row]:
        """All numbers of samples of the first engine, then of the next."""
        return [
            {"engine": name, "samples": int(n)}
            for name in self.engines
            for n in self.samples
        ]

    def describe(self) -> Row:
        """Numbers of samples, and digests of the prior and the engines."""
        known, seen = hashlib.sha256(), hashlib.sha256()
        leaves = jax.tree.leaves((self.prior.network, self.prior.population))
        for leaf in leaves:
            known.update(np.ascontiguousarray(leaf).tobytes())
        for name in self.engines:
            data = self.engines[name]
            told = str(data) if isinstance(data, DataError) else data_hash(data)
            seen.update(f"{name} {told}\n".encode())
        return {
            "kind": "calibration",
            "prior": known.hexdigest(),
            "samples": list(map(int, self.samples)),
            "engines": {"count": len(self.engines), "sha256": seen.hexdigest()},
        }

    def run(self, indices: Sequence[int]) -> list[Row]:
        """One row per index; engines whose records are none of the fleet are rows
        too."""
        names, rows = list(self.engines), []
        judged = functools.lru_cache(maxsize=1)(self._judge_mean)
        for index in indices:
            engine, place = divmod(int(index), len(self.samples))
            data = self.engines[names[engine]]
            try:
                if isinstance(data, DataError):
                    raise data
                begin, as_is = judged(names[engine])
                few = _first_rows(data, begin + self.samples[place])
                found = calibrate(self.prior, few)
                own = self._judge(found.value, data)[1]
                rows.append(self._row(found, own, as_is))
            except (DataError, SpecError) as error:
                rows.append(self._row(None, {}, {}, str(error)))
        return rows

    def _judge_mean(self, name: str) -> tuple[int, dict[str, float]]:
        """As `_judge`, of the population's mean."""
        data = self.engines[name]
        assert isinstance(data, Dataset)
        return self._judge(self.prior.network, data)

    def _judge(self, network: Network, data: Dataset) -> tuple[int, dict[str, float]]:
        """Samples of the first record before the first that calibrates, and free-run
        NRMSE by output, behind those that calibrate."""
        run = simulate(network, data).value
        seen = np.asarray(run.scored[0]).any(axis=1)
        first = max(int(np.argmax(seen)), self.prior.warm_up)
        begin = first + max(self.samples)
        told = {}
        for k, (o, name) in enumerate(
            zip(network.modelled, network.output_names, strict=True)
        ):
            y, far = [], []
            for n, record in enumerate(data):
                at = np.array(run.scored[n][:, k])
                at[: begin if n == 0 else 0] = False
                y.append(record.y[at, o])
                far.append(run.outputs[n][at, k] - record.y[at, o])
            y, far = np.concatenate(y), np.concatenate(far)
            if not len(y):
                raise DataError(
                    f"no sample of {name} is left to judge behind the {begin} that "
                    "calibrate; take fewer, or add a record",
                    channel=name,
                )
            lost = any(bool(d[k]) for d in run.diverged)
            error = np.sqrt(np.mean(far**2)) / max(float(y.std()), 1e-12)
            told[name] = np.inf if lost else float(error)
        return first, told

    def _row(
        self,
        found: Solution[Network] | None,
        own: dict[str, float],
        as_is: dict[str, float],
        detail: str = "",
    ) -> Row:
        stats = {} if found is None else found.stats
        row: Row = {
            "status": "nonfinite_data" if found is None else found.status_name,
            "detail": detail if found is None else found.detail,
        }
        row |= {name: stats.get(name) for name in FACTS}
        for name in self.prior.network.output_names:
            row |= {
                f"{name}_way": stats.get("way", {}).get(name, ""),
                f"{name}_weight": stats.get("weight", {}).get(name),
                f"{name}_free_run": own.get(name),
                f"{name}_as_is": as_is.get(name),
            }
        return row


def _first_rows(data: Dataset, rows: int) -> Dataset:
    """The first record up to so many samples."""
    one = data.records[0]
    short = dataclasses.replace(
        one,
        u=one.u[:rows],
        y=one.y[:rows],
        valid=one.valid[:rows],
        scored=None if one.scored is None else one.scored[:rows],
    )
    return dataclasses.replace(data, records=(short,))
