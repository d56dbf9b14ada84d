"""A structure found on one engine, refitted on another: work for a sweep's folder."""

import dataclasses
import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np

import jaxnarx as jnx
from jaxnarx.refinement import freeze
from jaxnarx.settings import replace_at

Row = dict[str, Any]


@dataclasses.dataclass(frozen=True, eq=False)
class RefitWork:
    """Terms and regions of a donor; coefficients made anew on every engine.

    `work` is the sweep that found them; `pairs` are (engine, structure, donor): the
    name of the engine to fit, what the table calls the structure, and the engine in
    whose row of `rows` it was found. The regions are the donor's refined ones, in
    physical units. Local least squares, then the coefficients alone by `refinement`,
    judged by the validation record. Structure `"as it is"` is the donor's network
    without any fit.
    """

    work: jnx.sweep.IdentificationWork
    rows: dict[str, Row]
    pairs: Sequence[tuple[str, str, str]]
    refinement: jnx.SimulationError

    @property
    def members(self) -> list[Row]:
        """Engine, structure and donor of every fit."""
        names = ("engine", "structure", "donor")
        return [dict(zip(names, pair, strict=True)) for pair in self.pairs]

    def describe(self) -> dict[str, Any]:
        """The settings, and digests of fleet and donors."""
        donors = sorted({donor for _, _, donor in self.pairs})
        keys = ("term_index", "partition", "coefficient")
        told = repr([[self.rows[d][key] for key in keys] for d in donors])
        return {
            "kind": "refitted structures",
            "fleet": self.work.fleet.digest(),
            "donors": hashlib.sha256(told.encode()).hexdigest(),
            "method": repr(self.work.method),
            "refinement": repr(self.refinement),
        }

    def run(self, indices: Sequence[int]) -> list[Row]:
        """A row for each pair."""
        return [self._one(*self.pairs[n]) for n in indices]

    def _one(self, engine: str, structure: str, donor: str) -> Row:
        fleet = self.work.fleet
        own = fleet.index(engine)
        if fleet.status[own] != "ok":
            return {"status": fleet.status[own]} | _figures({})
        data = {p: fleet.dataset(own, p) for p in fleet.parts}
        row = self.rows[donor]
        network = jnx.sweep.network_of(self.work, row)
        status = "ok"
        if structure != "as it is":
            terms = terms_of(self.work.pool, row["term_index"])
            start = jnx.grow(terms, data["train"], jnx.Given(network)).value
            solution = jnx.refine(
                *(start, data["train"], self.refinement),
                validation=data["validation"],
                trainable=freeze(start, partition=False),
            )
            network, status = solution.value, solution.status_name
        found = {p: free_run(network, d) for p, d in data.items()}
        if not all(np.isfinite(list(found.values()))):
            status = "diverged"
        return {"status": status} | _figures(found)


def _figures(found: dict[str, float]) -> Row:
    parts = ("train", "validation", "test")
    return {f"{part}_free_run": found.get(part) for part in parts}


def terms_of(pool: jnx.Pool, index: Sequence[int]) -> jnx.Pool:
    """The pool of some terms alone."""
    return dataclasses.replace(pool, factor=pool.factor[np.asarray(index)])


def free_run(network: jnx.Network, data: jnx.Dataset) -> float:
    """NRMSE of the free run of a record, infinite where it has diverged."""
    solution = jnx.simulate(network, data)
    if solution.status_name != "ok":
        return float("inf")
    first = network.history
    y = np.concatenate([r.y[first:, 0] for r in data])
    value = solution.value
    run = np.concatenate([value[n][first:, 0] for n in range(len(value))])
    return float(np.sqrt(np.mean((y - run) ** 2)) / np.std(y))


def restricted(
    work: jnx.sweep.IdentificationWork, row: Row
) -> jnx.sweep.IdentificationWork:
    """Every engine with the terms of a row, and regions of its own."""
    terms = terms_of(work.pool, row["term_index"])
    few = replace_at(work.method, {"select.max_terms": len(row["term_index"])})
    method = dataclasses.replace(few, pool=terms)
    return jnx.sweep.IdentificationWork(work.fleet, method, lanes=work.lanes)
