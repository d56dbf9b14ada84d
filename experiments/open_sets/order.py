"""In which order candidates that are trained step by step pay most.

From the leaderboards of `open_sets.json`: errors on groups of training records left
out, of all outputs of the open sets and virtual engines; no test record has a part in
it. What a candidate is worth on a problem is the logarithm by which it lowers the
smallest error so far, which begins with that of the closed forms and linear models; one
that was given up, or not tried, is worth nothing. The order is built one by one, next
comes what is worth most for its seconds, both summed over the problems where it was
tried.

    python experiments/open_sets/order.py

Of 32 outputs, 25 of them of virtual engines, twelve are better by what is trained. All
seven of public sets, of one or two inputs: Silverbox by a factor of 29 and the
Wiener-Hammerstein circuit by 23 with sigmoid states, the Bouc-Wen damper by 2.5 with
them, the tanks by 1.8 with states that saturate, the drives by 2.2 with regions, the
stirred tank by 2.6 and 3.1 as a polynomial of degree three, which then broke its
promise. Four of engines with one or two inputs by hidden states (up to two), and one
concentration of the diesel by sigmoid states. LOLIMOT was never ahead. So hidden and
sigmoid states come first, for few inputs, then degree three where the pool bears it,
LOLIMOT behind the polynomials, and a search goes on only while something is near the
best (`Preset.patience`).
"""

import json
import math
from collections import defaultdict
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).resolve().parents[1] / "benchmarks" / "results"
TRAINED = ("polynomial NARX", "LOLIMOT", "hidden states", "sigmoid states")
"""Families whose candidates are trained one by one."""
TINY = 1e-12
Problem = tuple[float, dict[str, tuple[float, float]]]
"""The smallest error without them; error and seconds of each by its name."""


def problems(sets: dict[str, Any]) -> list[Problem]:
    """Of every output with a leaderboard."""
    found = []
    for one in sets.values():
        outputs = defaultdict(list)
        for row in one.get("leaderboard", []):
            outputs[row["output"]].append(row)
        found += [problem(rows) for rows in outputs.values()]
    return [one for one in found if one is not None]


def problem(rows: list[dict[str, Any]]) -> Problem | None:
    """None where nothing but what is trained has an error."""
    able = [r for r in rows if r["free_run"] is not None and r["family"] not in TRAINED]
    if not able:
        return None
    tried: dict[str, tuple[float, float]] = {}
    for row in rows:
        if row["family"] in TRAINED:
            # One training makes a candidate for every pull.
            name = f"{row['family']}: {row['name']}".partition(", pull")[0]
            least, seconds = tried.get(name, (math.inf, 0.0))
            error = math.inf if row["free_run"] is None else row["free_run"]
            tried[name] = min(least, error), seconds + row["seconds"]
    return min(row["free_run"] for row in able), tried


def ordered(given: list[Problem]) -> list[tuple[str, int, float, float]]:
    """Name, problems it was tried on, what it is worth behind those before it, and its
    seconds, summed over these."""
    best = [error for error, _ in given]
    names = {name for _, tried in given for name in tried}
    found = []
    while names:
        worth = {name: _worth(name, given, best) for name in sorted(names)}
        name = max(worth, key=lambda n: worth[n][1] / max(worth[n][2], 1e-9))
        found.append((name, *worth[name]))
        names.remove(name)
        for k, (_, tried) in enumerate(given):
            best[k] = min(best[k], tried.get(name, (math.inf,))[0])
    return found


def _worth(
    name: str, given: list[Problem], best: list[float]
) -> tuple[int, float, float]:
    count, gain, seconds = 0, 0.0, 0.0
    for (_, tried), least in zip(given, best, strict=True):
        if name in tried:
            error, took = tried[name]
            count, seconds = count + 1, seconds + took
            if error < least:
                gain += math.log(least / max(error, TINY))
    return count, gain, seconds


def main() -> None:
    """Print the order."""
    path = RESULTS / "open_sets.json"
    sets = json.loads(path.read_text(encoding="utf-8"))["figures"]["sets"]
    given = problems(sets)
    print(f"{len(given)} problems\n{'':52s} tried   gain  seconds")
    for name, count, gain, seconds in ordered(given):
        print(f"{name:52s} {count:5d} {gain:6.2f} {seconds:8.0f}")


if __name__ == "__main__":
    main()
