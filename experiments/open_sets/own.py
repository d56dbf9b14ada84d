"""What jaxnarx makes of an open set: one identification, scored once at its end.

A method takes training records and returns a network and the rows of its leaderboard.
Only the standard library is imported here; the rest inside the functions.
"""

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from packed import pack, told
from score import digits, free_runs, scores
from sets import READERS, OpenSet, smaller
from virtual import BEDS, engine

Row = dict[str, Any]
Method = Callable[[Any], tuple[Any, Sequence[Row]]]

KEPT = (
    *("rank", "family", "name", "output", "free_run", "standard_error", "worst_group"),
    *("one_step", "diverged", "operations", "parameters", "seconds"),
)
"""Fields that the table keeps of models that it scores ..."""
LISTED = ("output", "family", "name", "free_run", "seconds")
"""... and of all others, from which `order.py` is made."""

LINEAR = ("OE", "OE with filtered inputs")
"""Names that the family of linear output-error models may have."""

NAMES = (*READERS, *(f"engine-{bed}" for bed in BEDS))


def load(name: str, data: str, *, small: bool) -> OpenSet:
    """An open set by its name; small for a smoke run. float64 is switched on."""
    import jax

    jax.config.update("jax_enable_x64", True)
    if name in READERS:
        found = READERS[name](Path(data))
        return smaller(found) if small else found
    bed = name.removeprefix("engine-")
    return engine(bed, length=400, train=2) if small else engine(bed)


def prepare(name: str, data: str, small: bool, path: str) -> Row:
    """Write a set for the peers."""
    return pack(load(name, data, small=small), Path(path))


# Methods -----------------------------------------------------------------------------


def automatic(preset: str, budget: float | None) -> Method:
    """Everything chosen by `identify`."""
    import jaxnarx as jnx
    from jaxnarx.identification import read_search

    def method(train: Any) -> tuple[Any, Sequence[Row]]:
        with tempfile.TemporaryDirectory() as place:
            fit = jnx.identify(train, preset=preset, budget=budget, folder=place)
            board, store = fit.stats["leaderboard"], read_search(Path(place))
            rows: list[Row] = []
            for output in board.outputs:
                taken = board.choose(output)
                for rank, one in enumerate(board.of(output), 1):
                    name, _ = board.worst_group(one) or ("", None)
                    more = {"rank": rank, "chosen": one == taken, "worst_group": name}
                    if one.family in LINEAR and one.eligible:
                        more["network"] = store.network(one.number)
                    rows.append(one.to_dict() | more)
        return fit.value, rows

    return method


def fixed(small: bool) -> Method:
    """One structure for all sets, as `identify` makes it without a search."""
    import jaxnarx as jnx

    settings = jnx.Identification()
    if small:
        settings = jnx.Identification(
            pool=jnx.Polynomial(input_lags=(1, 2, 4), output_lags=(1, 2), degree=1),
            select=jnx.ForwardOLS(max_terms=4),
            refine=None,
        )

    def method(train: Any) -> tuple[Any, Sequence[Row]]:
        return jnx.identify(train, settings).value, ()

    return method


def best_linear(rows: Sequence[Row], output: str) -> tuple[Row, Any] | None:
    """The best linear output-error model of the leaderboard, trained on all records.

    Its row and its network: what the row holds under `network`, or what that makes when
    called. None where the leaderboard has no such model.
    """
    import jaxnarx as jnx

    linear = [
        row
        for row in rows
        if row["family"] in LINEAR
        and row.get("output") in (None, output)
        and row.get("network") is not None
        and figure(row, "free_run", output) is not None
    ]
    if not linear:
        return None
    row = min(linear, key=lambda row: figure(row, "free_run", output))
    network = row["network"]
    return row, network if isinstance(network, jnx.Network) else network()


# Rows --------------------------------------------------------------------------------


def figure(row: Row, key: str, output: str) -> Any:
    """A figure of the leaderboard as JSON keeps it; of this output where it has more
    than one."""
    value = row.get(key)
    if isinstance(value, Mapping):
        value = value.get(output)
    if isinstance(value, str | bool | None):
        return value
    value = float(value)
    if value.is_integer():
        return int(value)
    return digits(value) if abs(value) < float("inf") else None


def kept(row: Row, output: str, keys: Sequence[str] = KEPT) -> Row:
    """A row of the leaderboard as the table keeps it."""
    return {key: figure(row, key, output) for key in keys if key in row}


def chosen(rows: Sequence[Row], output: str) -> Row:
    """The row of the model that was taken: marked as chosen, or the first in rank."""
    own = [row for row in rows if row.get("output") in (None, output)]
    marked = [row for row in own if row.get("chosen")]
    ranked = sorted(own, key=lambda row: row["rank"])
    return kept((marked or ranked)[0], output) if own else {"family": "fixed"}


def fit(
    name: str,
    data: str,
    small: bool,
    method: str,
    preset: str,
    budget: float | None,
    cache: str | None,
) -> Row:
    """Identify a set and score the test: columns of every output, and the table.

    `cache` is a folder for compiled programs.
    """
    import jax

    if cache is not None:
        jax.config.update("jax_compilation_cache_dir", cache)
    found = load(name, data, small=small)
    identify = fixed(small) if method == "fixed" else automatic(preset, budget)
    begin = time.perf_counter()
    network, rows = identify(found.train)
    seconds = round(time.perf_counter() - begin, 1)
    runs, columns = free_runs(network, found), {}
    about = {"preset": method if method == "fixed" else preset, "fit_seconds": seconds}
    for output in found.outputs:
        models = {"jaxnarx": (chosen(rows, output) | about, runs)}
        if (linear := best_linear(rows, output)) is not None:
            row, model = linear
            models["best linear"] = kept(row, output), free_runs(model, found)
        tests = scores([own for _, own in models.values()], found, output)
        columns[output] = {
            name: row | {"test": test}
            for (name, (row, _)), test in zip(models.items(), tests, strict=True)
        }
    outputs = found.outputs[0]
    table = [kept(row, row.get("output") or outputs, LISTED) for row in rows]
    return {"about": told(found), "columns": columns, "leaderboard": table}
