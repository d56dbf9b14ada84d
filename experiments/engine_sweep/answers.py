"""What the sweep's rows say: terms, partitions, transfer."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import rankdata

import jaxnarx as jnx

Row = dict[str, Any]
GROUPS = ("engine", "noise", "excitation")
PERMUTATIONS = 500
HALF = 1e-6
"""Rounding that a border may have."""


def group_of(row: Row) -> str:
    """What a member is varied by."""
    return row["engine"].split()[0]


def grouped(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows with a model, by what varies them."""
    return {
        group: [r for r in rows if group_of(r) == group and r["term_index"]]
        for group in GROUPS
    }


# Terms -------------------------------------------------------------------------------


def term_figures(rows: Sequence[Row]) -> dict[str, Any]:
    """How often each term is chosen, and how alike the sets of two members are."""
    groups = grouped(rows)
    shares = {group: term_shares(own) for group, own in groups.items()}
    first = sorted(shares["engine"], key=lambda t: -shares["engine"][t])
    return {
        "different": {g: len(s) for g, s in shares.items()},
        "in_every": {g: sum(v == 1.0 for v in s.values()) for g, s in shares.items()},
        "jaccard": {g: spread(jaccard(own)) for g, own in groups.items()},
        "share": {
            term: {group: shares[group].get(term, 0.0) for group in GROUPS}
            for term in first[:20]
        },
    }


def term_shares(rows: Sequence[Row]) -> dict[str, float]:
    """Share of the rows that hold each term."""
    count = Counter(term for row in rows for term in row["term_names"])
    return {term: n / len(rows) for term, n in count.items()}


def jaccard(rows: Sequence[Row]) -> Float[np.ndarray, " pairs"]:
    """Common terms over all terms of every two rows."""
    known = sorted({i for row in rows for i in row["term_index"]})
    has = np.array([[i in row["term_index"] for i in known] for row in rows], float)
    common = has @ has.T
    size = has.sum(axis=1)
    alike = common / (size[:, None] + size[None] - common)
    return alike[np.triu_indices(len(rows), 1)]


# Partitions --------------------------------------------------------------------------


def boxes(row: Row, k_sigma: float) -> Float[np.ndarray, "2 models dims"]:
    """Lower and upper corners of the boxes that LOLIMOT has made."""
    centre = np.reshape(row["centre"], (row["model_count"], -1))
    half = np.reshape(row["width"], centre.shape) / k_sigma / 2
    return np.round(np.stack([centre - half, centre + half]), 4)


def signature(row: Row, k_sigma: float) -> tuple:
    """The boxes in an order that does not depend on how they were made."""
    low, high = boxes(row, k_sigma)
    both = np.concatenate([low, high], axis=1)
    return tuple(sorted(map(tuple, (both + 0.0).tolist())))


def first_split(row: Row, k_sigma: float) -> str:
    """The dimension that was halved first: no box stands across its middle."""
    low, high = boxes(row, k_sigma)
    across = np.any((low < 0.5 - HALF) & (high > 0.5 + HALF), axis=0)
    found = [str(d) for d in np.flatnonzero(~across)]
    return " or ".join(found) or "none"


def halving_figures(rows: Sequence[Row], k_sigma: float) -> dict[str, Any]:
    """How many partitions LOLIMOT makes, and whether two members have the same."""
    found = {}
    for group, own in grouped(rows).items():
        seen = Counter(signature(row, k_sigma) for row in own)
        count = len(own)
        pairs = max(count * (count - 1), 1)
        found[group] = {
            "members": count,
            "different": len(seen),
            "commonest": max(seen.values(), default=0) / max(count, 1),
            "two_agree": sum(n * (n - 1) for n in seen.values()) / pairs,
            "first_split": dict(Counter(first_split(r, k_sigma) for r in own)),
        }
    return found


def features(row: Row) -> Float[np.ndarray, " features"]:
    """Centres of the refined partition, each dimension sorted by itself."""
    centre = np.reshape(row["centre"], (row["model_count"], -1))
    return np.sort(centre, axis=0).T.reshape(-1)


def movement_figures(
    rows: Sequence[Row],
    halved: Sequence[Row],
    factors: Float[np.ndarray, "engines varied"],
    names: Sequence[str],
    k_sigma: float,
    seed: int,
) -> dict[str, Any]:
    """How far refined centres spread in each group, and what they follow.

    The spread is the root mean variance of the sorted centres. Rank correlations of
    these, and of having the commonest boxes, with the engine's parameters; the level is
    what the largest of all reaches in one of twenty shuffles of the engines.
    """
    most = max(row["model_count"] for row in rows)
    groups = {
        group: [r for r in own if r["model_count"] == most]
        for group, own in grouped(rows).items()
    }
    values = {g: np.array([features(r) for r in own]) for g, own in groups.items()}
    own = groups["engine"]
    by_name = {r["engine"]: signature(r, k_sigma) for r in grouped(halved)["engine"]}
    common = Counter(by_name.values()).most_common(1)[0][0]
    usual = np.array([by_name[r["engine"]] == common for r in own], float)
    at = [int(r["engine"].split()[1]) for r in own]
    dims = values["engine"].shape[1] // most
    labels = [f"centre {m} of dimension {d}" for d in range(dims) for m in range(most)]
    table = np.column_stack([values["engine"], usual])
    follow = correlations(table, factors[at], seed)
    return {
        "models": most,
        "spread": {g: variation(v, seed) for g, v in values.items()},
        "ratio_to_noise": ratio(values["engine"], values["noise"], seed),
        **strongest(follow, [*labels, "commonest boxes"], names),
    }


def variation(values: Float[np.ndarray, "members features"], seed: int) -> dict:
    """Root mean variance with its bootstrap interval."""
    return interval(lambda v: deviation(v), [values], seed)


def ratio(a, b, seed: int) -> dict:
    """Variation of one group over that of another."""
    return interval(lambda x, y: deviation(x) / max(deviation(y), 1e-12), [a, b], seed)


def deviation(values: Float[np.ndarray, "members features"]) -> float:
    """Root of the mean variance of the columns."""
    return float(np.sqrt(np.mean(np.var(values, axis=0))))


def interval(figure, groups: Sequence[np.ndarray], seed: int) -> dict[str, float]:
    """A figure of groups of rows, with the 95 % interval of 1,000 resamples."""
    random = np.random.default_rng(seed)
    draws = []
    for _ in range(1000):
        some = [g[random.integers(len(g), size=len(g))] for g in groups]
        draws.append(figure(*some))
    low, high = np.quantile(draws, [0.025, 0.975])
    return {"value": figure(*groups), "low": float(low), "high": float(high)}


def correlations(
    values: Float[np.ndarray, "engines features"],
    factors: Float[np.ndarray, "engines varied"],
    seed: int,
) -> tuple[Float[np.ndarray, "features varied"], float]:
    """Spearman's rank correlations, and the level of the largest by chance alone."""
    x, y = _ranks(values), _ranks(factors)
    random = np.random.default_rng(seed)
    largest = [
        np.abs(x.T @ y[random.permutation(len(y))]).max() for _ in range(PERMUTATIONS)
    ]
    return x.T @ y, float(np.quantile(largest, 0.95))


def _ranks(values: Float[np.ndarray, "rows columns"]):
    ranks = rankdata(values, axis=0)
    centred = ranks - ranks.mean(axis=0)
    size = np.linalg.norm(centred, axis=0)
    return centred / np.where(size > 0, size, 1.0)


def strongest(follow, features: Sequence[str], varied: Sequence[str]) -> dict[str, Any]:
    """The correlations beyond chance, the largest first."""
    rho, level = follow
    order = np.argsort(-np.abs(rho), axis=None)
    rows = []
    for place in order[:8]:
        f, v = np.unravel_index(place, rho.shape)
        rows.append({"of": features[f], "with": varied[v], "rho": float(rho[f, v])})
    return {
        "chance": level,
        "beyond_chance": int(np.sum(np.abs(rho) > level)),
        "compared": int(rho.size),
        "strongest": rows,
    }


# Scores ------------------------------------------------------------------------------


def compared(
    rows: Sequence[Row], factor: str, before: str, after: str, by: str, seed: int
) -> dict[str, Any]:
    """Paired comparison over engines, as plain figures."""
    table = jnx.sweep.SweepTable.from_rows(rows)
    good = [set(_ended_well(rows, factor, level, by)) for level in (before, after)]
    if not good[0] & good[1]:
        return {"pairs": 0}
    found = jnx.sweep.paired_comparison(
        table, pair=["engine"], factor=factor, levels=(before, after), by=by, seed=seed
    )
    figures = {
        name: [getattr(getattr(found, name), end) for end in ("value", "low", "high")]
        for name in ("ratio", "difference", "improved")
    }
    return figures | {
        "pairs": len(found.before),
        "failed_before": found.failed_before,
        "failed_after": found.failed_after,
        "failed_both": found.failed_both,
        "worst": found.worst,
    }


def _ended_well(rows: Sequence[Row], factor: str, level: str, by: str) -> list[str]:
    """Engines with a finite score at a level."""
    table = jnx.sweep.SweepTable.from_rows([r for r in rows if r[factor] == level])
    score = np.where(table.okay, table.numbers(by), np.nan)
    return table.column("engine")[np.isfinite(score)].tolist()


def spread(values: Float[np.ndarray, " members"]) -> dict[str, float]:
    """Median, and the values that 5 and 95 % stay below."""
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return {"median": float(middle), "p5": float(low), "p95": float(high)}


def score_figures(rows: Sequence[Row], okay: Bool[np.ndarray, " rows"], key: str):
    """Median of a score over the members that ended well, and who is the worst."""
    good = [r for r, ok in zip(rows, okay, strict=True) if ok]
    good = [r for r in good if r[key] is not None and np.isfinite(r[key])]
    if not good:
        return {"members": 0}
    worst = max(good, key=lambda r: r[key])
    found = spread(np.array([r[key] for r in good]))
    return found | {"members": len(good), "worst": [worst["engine"], worst[key]]}
