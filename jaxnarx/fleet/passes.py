"""Passes over donors: sums about their coefficients, and the population from them."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxnarx.arrays import Progress
from jaxnarx.errors import DataError
from jaxnarx.fleet.broken import Screened, find_broken
from jaxnarx.fleet.climb import Climb
from jaxnarx.fleet.coefficients import FleetCoefficients
from jaxnarx.fleet.donors import (
    Donors,
    DonorTable,
    Pass,
    SumsShape,
    gather_donors,
    prepare_donor,
)
from jaxnarx.fleet.information import gather_information, parts_of
from jaxnarx.fleet.population import root_of
from jaxnarx.fleet.residuals import colour_of
from jaxnarx.simulation import Prepared

PASSES = 4
"""Linearisations at most, the first about the network as it was given."""
BEGIN_SPREAD = 0.5
"""Deviation of coefficients by which donors are first fitted one by one, in deviations
of the output."""
LINEAR_SHARE = 1e-3
"""Share of the loss by which it may differ from what was expected to first order."""
COLOURED_DONORS = 64
"""Donors by whose residuals it is told how coloured they are."""
PROBED_DONORS = 8
"""Donors by whose runs that is judged."""


@dataclasses.dataclass(frozen=True, eq=False)
class DonorWork:
    """Donors, and the coefficients in which they differ."""

    donors: Donors
    names: list[str]
    own: FleetCoefficients
    rungs: tuple[int, ...]
    skip: int
    folder: Path | None
    progress: Progress | None

    @property
    def shape(self) -> SumsShape:
        """Sizes of a donor's sums."""
        network = self.own.layout.base
        return SumsShape(len(network.modelled), len(self.own.free))

    def gather(
        self,
        number: int,
        start: np.ndarray,
        drawn: Climb | None,
        remark: dict[str, str],
    ) -> Pass:
        """Sums of all donors, each about its own coefficients."""
        every = len(self.names)
        name, row = f"pass{number}", self.shape.row
        table = DonorTable.begin(self.folder, name, every, row)

        def tell(n: int) -> None:
            if self.progress is not None:
                event = {"verb": "learn", "pass": number + 1, "done": n + 1}
                self.progress(event | {"of": every})

        own = self.donors, self.names, self.own, start, drawn
        gather_donors(*own, table, self.shape, self.skip, remark, tell)
        return Pass(table, self.shape)

    def runs(self, n: int) -> Prepared:
        """The prepared records of a donor."""
        return prepare_donor(
            self.own.layout.base, self.donors[self.names[n]], self.skip
        )


@dataclasses.dataclass(frozen=True, eq=False)
class FittedDonors:
    """A population, what was found about its donors, and from which sums."""

    screened: Screened
    sums: Pass
    remark: dict[str, str]
    passes: int

    @property
    def linear(self) -> bool:
        """Whether runs are linear in the coefficients that differ."""
        return self.passes == 1


def fit_donors(work: DonorWork) -> FittedDonors:
    """The population, from sums about the network; where runs lose other than these
    expect, from sums about the most probable coefficients of every donor.

    Residuals are taken for white until there are some; the population at the end knows
    their colour.
    """
    params = work.shape.params
    zero = np.zeros((len(work.names), params))
    colour = np.ones(work.shape.outputs)
    sums, remark = _gather(work, 0, zero, None)
    fitted = _screen(work, sums, remark, 1, colour)
    # What linear runs say of runs that are not is no start.
    start = zero
    drawn = Climb(np.zeros(params), BEGIN_SPREAD * np.eye(params), colour)
    while fitted.passes < PASSES and not _as_expected(work, fitted):
        sums, remark = _gather(work, fitted.passes, start, drawn)
        fitted = _screen(work, sums, remark, fitted.passes + 1, colour)
        found = fitted.screened.population
        root = root_of(np.asarray(found.covariance))
        start, drawn = fitted.sums.at, Climb(np.asarray(found.mean), root, colour)
    colour = _measure_colour(work, fitted.screened)
    return _screen(work, sums, remark, fitted.passes, colour)


def _gather(
    work: DonorWork,
    number: int,
    start: Float[np.ndarray, "donors params"],
    drawn: Climb | None,
) -> tuple[Pass, dict[str, str]]:
    """Sums about coefficients near these, and what is wrong with donors that cannot be
    run."""
    remark: dict[str, str] = {}
    return work.gather(number, start, drawn, remark), remark


def _screen(
    work: DonorWork,
    sums: Pass,
    remark: dict[str, str],
    passes: int,
    colour: Float[np.ndarray, " outputs"],
) -> FittedDonors:
    """The population of the donors that are not broken."""
    there = _have_samples(sums, work.names, remark)
    names = work.own.layout.base.output_names
    found = find_broken(sums.chunks, there, names, colour)
    notes = remark | {work.names[n]: text for n, text in found.remark.items()}
    return FittedDonors(found, sums, notes, passes)


def _measure_colour(work: DonorWork, found: Screened) -> Float[np.ndarray, " outputs"]:
    """How many samples of the residuals tell as much as one, in the median of some
    donors."""
    picked = np.flatnonzero(found.used)[:COLOURED_DONORS].tolist()
    each = [colour_of(work.own, found.estimate[n], work.runs(n)) for n in picked]
    return np.median(each, axis=0)


def _have_samples(
    sums: Pass, names: list[str], remark: dict[str, str]
) -> Bool[np.ndarray, " donors"]:
    """Donors of which samples count; DataError where there is none."""
    rows = [
        np.asarray(c[0].samples).sum(axis=1) > 0 for c in sums.chunks(sums.at[:, 0])
    ]
    there = np.concatenate(rows)[: len(names)]
    for n in np.flatnonzero(~there).tolist():
        remark.setdefault(names[n], "no sample counts")
    if not there.any():
        first = "; ".join(f"{n}: {t}" for n, t in list(remark.items())[:3])
        raise DataError(f"not one donor can be run: {first}")
    return there


def _as_expected(work: DonorWork, fitted: FittedDonors) -> bool:
    """Whether runs of some donors lose what the sums of the last pass expect."""
    estimate, sums = fitted.screened.estimate, fitted.sums
    for n in np.flatnonzero(fitted.screened.used)[:PROBED_DONORS].tolist():
        expected = sums.one(n).loss(estimate[n] - sums.at[n])
        runs = work.runs(n)
        part = jax.device_put(parts_of(runs, ()))
        true = gather_information(work.own, estimate[n], runs, part, 1).square[0]
        if not np.allclose(true, expected, rtol=LINEAR_SHARE):
            return False
    return True
