"""Models with hidden states: chosen on groups left out, trained on all, scored once."""

import dataclasses
import time
from typing import Any

from score import digits, free_runs, scores  # pyright: ignore
from sets import OpenSet  # pyright: ignore
from structures import FINAL, named  # pyright: ignore

Row = dict[str, Any]


def window(open_set: OpenSet) -> int:
    """Samples that hidden states are estimated from, behind the one of their history:
    the official start."""
    return min(part.window for part in open_set.parts.values()) - 1


def groups_of(open_set: OpenSet) -> Any:
    """What is left out together, as `jaxnarx.identify` makes it without being told."""
    from jaxnarx.data import groups
    from jaxnarx.partition import profile_data

    train = open_set.train
    memory = max(profile_data(train, output).memory for output in open_set.outputs)
    return groups(train, gap=memory)


def judged(method: Any, open_set: OpenSet, best: Any, rows: int) -> list[Row]:
    """Errors of a structure on groups left out, one row for every pull.

    `best` are the mean squared errors of the best so far, group by group; at most
    `rows` samples, in stretches, train.
    """
    import numpy as np

    from jaxnarx.errors import JaxnarxError
    from jaxnarx.identification.cross_validate import cross_validate

    train, begin = open_set.train, time.perf_counter()
    o = train.channels.output_names.index(method.outputs[0])
    spread = float(np.concatenate([r.y[:, o] for r in train]).std())
    own = None if best is None else np.asarray(best)
    try:
        every = cross_validate(
            *(method, train, groups_of(open_set), spread, own, rows), one_step=False
        )
    except (JaxnarxError, np.linalg.LinAlgError) as error:
        return [_row(method, method.stages[0], begin, 1) | {"failed": str(error)}]
    found = []
    for stage, one in zip(method.stages, every, strict=True):
        row = _row(method, stage, begin, len(every))
        row["groups"] = [
            digits(e**0.5) if e == e else None for e in map(float, one.losses)
        ]
        if one.complete:
            mean = np.nansum(one.losses * one.counts) / one.counts.sum()
            row["free_run"] = digits(float(mean) ** 0.5)
        else:
            row["failed"] = one.detail
        found.append(row)
    return found


def _row(method: Any, stage: tuple[int, float], begin: float, count: int) -> Row:
    seconds, (regions, pull) = round((time.perf_counter() - begin) / count, 1), stage
    size = {"states": method.states, "degree": method.degree}
    size |= {"regions": regions, "pull": pull}
    name = f"{named(method, regions)}, pull {pull:g}"
    return {"name": name, "seconds": seconds} | size


def best_of(rows: list[Row]) -> Row | None:
    """The smallest error on what was left out."""
    able = [row for row in rows if "free_run" in row]
    return min(able, key=lambda row: row["free_run"]) if able else None


def taken(rows: list[Row]) -> Row | None:
    """The one that is trained on everything: by the rule of `jaxnarx.identify`, the
    cheapest that is as good as the best to 5 % and a standard error."""
    from jaxnarx.identification.leaderboard import Candidate, Leaderboard

    able = [row for row in rows if "free_run" in row]
    contenders = [
        Candidate(
            *("", n, "hidden states", row["name"]),
            free_run=row["free_run"],
            groups=tuple(row["groups"]),
            operations=_size(row),
        )
        for n, row in enumerate(able)
    ]
    found = Leaderboard(tuple(contenders)).choose("")
    return None if found is None else able[found.number]


def _size(row: Row) -> int:
    """What stands for the operations of a structure."""
    regions = row.get("regions", 1)
    return (row["states"] + 1) * row["states"] ** row["degree"] * regions


def losses(rows: list[Row]) -> list[float] | None:
    """Mean squared errors of the best so far, group by group."""
    found = best_of(rows)
    if found is None:
        return None
    return [float("nan") if e is None else e**2 for e in found["groups"]]


def finished(method: Any, row: Row, open_set: OpenSet, rows: int) -> Any:
    """The chosen structure trained on all training samples, and the seconds of it.

    Of up to `rows` samples that is the network that was judged; longer ones have
    trained it in stretches, and now do as a whole, with more steps.
    """
    from jaxnarx.identification.cross_validate import fit_full
    from jaxnarx.linear import drop_inactive

    train = open_set.train
    at = method.stages.index((row.get("regions", 1), row["pull"]))
    if train.samples <= rows:
        data = groups_of(open_set).exclude_group(train)
    else:
        data, method = train, dataclasses.replace(method, max_steps=FINAL)
    begin = time.perf_counter()
    network = drop_inactive(fit_full(method, data)[at])
    return network, round(time.perf_counter() - begin, 1)


def column(network: Any, row: Row, seconds: float, open_set: OpenSet) -> Row:
    """A network scored on the test; `row` is what was known when it was chosen."""
    from jaxnarx.evaluation import cost

    price = cost(network)
    (output,) = network.output_names
    return {
        "family": "hidden states",
        "name": row["name"],
        "free_run": row["free_run"],
        "parameters": price.parameters,
        "operations": price.operations,
        "fit_seconds": seconds,
        "test": scores([free_runs(network, open_set)], open_set, output)[0],
    }
