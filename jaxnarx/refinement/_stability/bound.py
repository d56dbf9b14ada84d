"""A sufficient bound: one norm in which every step of the recursion contracts.

Two runs with the same inputs differ by d_t, and clip(a) - clip(b) = c (a - b) with c in
[0, 1]. By the mean value theorem d moves by companion matrices [c A; shift] with A from
the hull of the derivative between both histories. If ||L M L^-1|| <= rho < 1 for all of
them, then |d_t| <= cond(L) rho^t |d_0| (Lohmiller and Slotine 1998; Angeli 2002). The
norm is convex in M, so the corners of the hull decide, c in {0, 1} among them.

A limit that acts at arbitrary times destroys contraction even of good linear models: it
needs Re H < 1 on the whole unit circle for y = H y (circle criterion), which slow
models of second order never meet. So the bound is looked for with the limits first, and
then for runs that stay inside them.
"""

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxnarx.models import Network
from jaxnarx.refinement._stability.hull import Interval, hull
from jaxnarx.refinement._stability.norm import contracting_norm, norms
from jaxnarx.refinement._stability.points import (
    Points,
    companion,
    group_block,
    jacobians,
    linked_groups,
    moduli,
    thin,
)
from jaxnarx.regressors import variable_names

ALL_WORDS = "for all outputs in the bounds"
RUN_WORDS = "along the run, sampled"

CORNERS_FOLLOWED = 64
"""Corners of the interval of A that are followed one by one; beyond, absolute values
bound what the radius can add."""
NORM_MATRICES = 8000
"""Matrices the norm is searched on; it is checked on all."""
OUTPUTS_FOLLOWED = 3
"""Outputs that act on one another for which every pattern of limits is followed."""


@dataclasses.dataclass(frozen=True, eq=False)
class Place:
    """One sample: `time` [s] in its record, scheduling variables in physical units."""

    record: str
    step: int
    time: float
    scheduling: dict[str, float]


@dataclasses.dataclass(frozen=True, eq=False)
class Bound:
    """A bound on how fast two runs with the same inputs approach each other.

    - `kind`: `"for all outputs in the bounds"`, proven for the inputs at the samples
      looked at whatever the outputs, or `"along the run, sampled"`: at the free run's
      own histories only, evidence and no proof;
    - `limits`: whether it holds while the feedback bound acts, else only for runs that
      stay inside it;
    - `rate`: largest factor per sample, in the norm found; the bound holds below 1;
    - `average`: geometric mean of the factors over the samples;
    - `overshoot`: how many times the distance of two runs may grow before it shrinks;
    - `fails`: share of `samples` whose factor reaches 1; `region`: range of each
      scheduling variable there; `worst`: the sample with the largest factor;
    - `samples` were looked at `of` those there are.
    """

    kind: str
    limits: bool
    rate: float
    average: float
    overshoot: float
    fails: float
    region: dict[str, tuple[float, float]]
    worst: Place
    samples: int
    of: int

    @property
    def holds(self) -> bool:
        """Every step looked at contracts."""
        return self.rate < 1.0


def corners(
    centre: Float[np.ndarray, "points outputs outputs depth"],
    radius: Float[np.ndarray, "points outputs outputs depth"],
    *,
    limits: bool,
) -> tuple[Iterator[np.ndarray], bool]:
    """Corners of the interval of A, limited rows zero; True where the radius is in
    them.
    """
    loose = np.argwhere(radius.max(axis=0) > 0)
    inside = 2 ** len(loose) <= CORNERS_FOLLOWED
    patterns = itertools.product((-1.0, 1.0), repeat=len(loose) if inside else 0)
    outputs = centre.shape[1]

    def walk():
        for signs in patterns:
            a = centre.copy()
            for (o, i, d), sign in zip(loose, signs, strict=False):
                a[:, o, i, d] += sign * radius[:, o, i, d]
            yield a
            for free in itertools.product((0.0, 1.0), repeat=outputs):
                if limits and 0 < sum(free) < outputs:
                    yield a * np.array(free)[None, :, None, None]
        if limits:
            yield np.zeros_like(centre[:1])

    return walk(), inside


def factors(
    l: Float[np.ndarray, "n n"],  # noqa: E741
    centre: Float[np.ndarray, "points outputs outputs depth"],
    radius: Float[np.ndarray, "points outputs outputs depth"],
    *,
    limits: bool,
) -> Float[np.ndarray, " points"]:
    """The largest ||L M L^-1|| of every sample over all its corners."""
    walk, inside = corners(centre, radius, limits=limits)
    out = np.zeros(len(centre))
    for a in walk:
        out = np.maximum(out, norms(l, companion(a)))
    if inside:
        return out
    r = companion(radius)
    r[:, centre.shape[1] :] = 0.0
    return out + np.linalg.norm(np.abs(l) @ r @ np.abs(np.linalg.inv(l)), axis=(1, 2))


def _norm_for(
    centre, radius, limits: bool, last: bool
) -> Float[np.ndarray, "n n"] | None:
    """The norm with the least factor; where none contracts, one that fails seldom.

    Corners with an unstable pole fail in every norm: None, unless it is the `last`
    claim; then they are left out of the search.
    """
    walk, _ = corners(centre[:1], radius.max(axis=0)[None], limits=limits)
    at = thin(len(centre), max(200, NORM_MATRICES // sum(1 for _ in walk)))
    walk, _ = corners(centre[at], radius[at], limits=limits)
    m = np.concatenate([companion(a) for a in walk])
    alive = moduli(m) < 1
    if not (last or alive.all()):
        return None
    if not alive.any():
        return np.eye(m.shape[1])
    m = m[alive]
    best = contracting_norm(m)
    found = norms(best, m)
    if found.max() < 1:
        return best
    # The worst few may bend the norm so far that it fails for many.
    other = contracting_norm(m[found <= np.quantile(found, 0.9, method="lower")])
    seldom = np.mean(norms(other, m) >= 1) < np.mean(found >= 1)
    return other if seldom else best


@dataclasses.dataclass(frozen=True, eq=False)
class _Sites:
    """The samples looked at, and what is needed to name them."""

    network: Network
    points: Points
    names: list[str]
    sample_time: float
    of: int

    def place(self, at: int) -> Place:
        step = int(self.points.step[at])
        return Place(
            self.names[self.points.record[at]],
            step,
            float(step * self.sample_time),
            {k: float(v[at]) for k, v in scheduling_at(self.network, self.points)},
        )

    def region(self, bad: np.ndarray) -> dict[str, tuple[float, float]]:
        if not bad.any():
            return {}
        values = scheduling_at(self.network, self.points)
        return {k: (float(v[bad].min()), float(v[bad].max())) for k, v in values}


def _find_bound(
    sites: _Sites, interval: Interval, kind: str, limits: bool, last: bool
) -> Bound | None:
    """The bound of one kind, outputs that do not touch each other apart.

    None where there is none; the `last` claim, the weakest, always gets figures.
    """
    centre, radius = interval
    linked = (np.abs(centre) + radius).max(axis=(0, 3)) > 0
    factor, average, overshoot = np.zeros(len(centre)), 0.0, 1.0
    for group in linked_groups(linked):
        if limits and len(group) > OUTPUTS_FOLLOWED:
            return None
        if not linked[np.ix_(group, group)].any():
            continue
        parts = group_block(centre, group), group_block(radius, group)
        l = _norm_for(*parts, limits, last)  # noqa: E741
        if l is None:
            return None
        own = factors(l, *parts, limits=limits)
        average = max(average, float(np.exp(np.mean(np.log(np.maximum(own, 1e-300))))))
        overshoot = max(overshoot, float(np.linalg.cond(l)))
        factor = np.maximum(factor, own)
    bad = factor >= 1
    return Bound(
        kind=kind,
        limits=limits,
        rate=float(factor.max()),
        average=average,
        overshoot=overshoot,
        fails=float(bad.mean()),
        region=sites.region(bad),
        worst=sites.place(int(np.argmax(factor))),
        samples=len(factor),
        of=sites.of,
    )


def scheduling_at(
    network: Network, points: Points
) -> list[tuple[str, Float[np.ndarray, " points"]]]:
    """Every scheduling variable once, by name, measured, in physical units."""
    out = {}
    for model, x in zip(network.models, points.x, strict=True):
        names = variable_names(network.channels, model.scheduling)
        out |= dict(zip(names, np.asarray(x, np.float64), strict=True))
    return list(out.items())


def bounds(
    network: Network,
    points: Points,
    names: list[str],
    sample_time: float,
    of: int,
) -> tuple[Bound, ...]:
    """Bounds from the strongest claim to the weakest, up to the first that holds.

    A claim that an unstable pole refutes is left out, unless it is the weakest, which
    then says where it fails. `points` carry the run's own histories, `names` are those
    of the records, `of` counts the samples that `points` stand for.
    """
    everywhere = hull(network, points)
    claims = [] if everywhere is None else [(ALL_WORDS, everywhere)]
    if everywhere is None or everywhere[1].any():
        a = jacobians(network, points)
        claims.append((RUN_WORDS, (a, np.zeros_like(a))))
    sites = _Sites(network, points, names, sample_time, of)
    out = []
    for (kind, interval), limits in itertools.product(claims, (True, False)):
        last = kind == claims[-1][0] and not limits
        found = _find_bound(sites, interval, kind, limits, last)
        if found is None:
            continue
        out.append(found)
        if found.holds:
            break
    return tuple(out)
