"""Stand-in for the search: fixed methods, judged on the last records."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.data import Dataset, hold_out
from jaxnarx.errors import SpecError
from jaxnarx.evaluation import cost
from jaxnarx.evaluation.notes import data_hash
from jaxnarx.evaluation.rows import collect, score
from jaxnarx.identification.leaderboard import Leaderboard, Row
from jaxnarx.identification.pools import make_pool
from jaxnarx.identification.search_folder import open_search
from jaxnarx.methods import ForwardOLS, Identification, Lolimot, Polynomial
from jaxnarx.models import Network
from jaxnarx.partition import grow
from jaxnarx.selection import select
from jaxnarx.simulation import predict, simulate
from jaxnarx.solution import RESULTS, Solution

CANDIDATES: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("constant", "mean", {"max_terms": 1}),
    ("ARX", "orders 1, 1", {"max_terms": 4}),
    ("polynomial", "quadratic, 6 terms", {"max_terms": 6, "degree": 2}),
    ("LOLIMOT", "2 regions of 4 terms", {"max_terms": 4, "models": 2}),
)


def search(
    data: Dataset,
    *,
    preset: str,
    budget: float | None,
    candidates: int | None,
    groups: Any,
    outputs: Sequence[str],
    folder: Path | None,
    progress: Callable[[dict[str, Any]], None] | None,
) -> Solution[Network]:
    tell = progress or (lambda event: None)
    names = _group_names(data)
    rule = "best" if preset == "best" else "near"
    board = Leaderboard((), tuple(names), rule)
    store: Any = _Memory(board)
    if folder is not None:
        key = {"data": data_hash(data), "preset": preset, "outputs": list(outputs)}
        store = open_search(folder, key, board)
    tried = [c for c in CANDIDATES if preset != "linear" or c[0] in ("constant", "ARX")]
    tried = tried[:candidates]
    begin, done, stopped = time.perf_counter(), 0, False
    of = len(tried) * len(outputs)
    if budget is not None and budget < 0.01:
        raise SpecError("budget: too small for one candidate", field="budget")
    try:
        for output in outputs:
            for family, name, settings in tried:
                if any(
                    (r.output, r.family, r.name) == (output, family, name)
                    for r in store.leaderboard
                ):
                    done += 1
                    continue
                tell(
                    {"verb": "search", "trying": f"{family}: {name}", "output": output}
                )
                number = 1 + max((r.number for r in store.leaderboard), default=0)
                row, network = _tried(data, output, family, name, settings, number)
                store = store.added(row, network)
                done += 1
                passed = time.perf_counter() - begin
                tell(
                    {
                        "verb": "search",
                        "row": row,
                        "chosen": store.leaderboard.chosen(output),
                        "done": done,
                        "of": of,
                        "seconds": passed,
                        "left": passed / done * (of - done),
                    }
                )
    except KeyboardInterrupt:
        if not len(store.leaderboard):
            raise
        stopped = True
    board = store.leaderboard
    chosen = [board.chosen(o) or board.of(o)[0] for o in board.outputs]
    network = _joined([store.network(r.number) for r in chosen])
    vetoed = any(board.chosen(o) is None for o in board.outputs)
    status = RESULTS.budget_spent if stopped else RESULTS.ok
    detail = "interrupted" if stopped else ""
    if vetoed:
        status, detail = RESULTS.diverged, "every candidate diverges"
    look = {o: {"dead time of speed": 2, "memory": 12} for o in board.outputs}
    return Solution(network, status, {"leaderboard": board, "look": look}, detail)


def _joined(networks: list[Network]) -> Network:
    if len(networks) == 1:
        return networks[0]
    from jaxnarx.models import merged  # pyright: ignore

    return merged(networks)


@dataclasses.dataclass
class _Memory:
    leaderboard: Leaderboard
    networks: dict[int, Network] = dataclasses.field(default_factory=dict)

    def added(self, row: Row, network: Network) -> "_Memory":
        self.networks[row.number] = network
        rows = (*self.leaderboard.rows, row)
        self.leaderboard = dataclasses.replace(self.leaderboard, rows=rows)
        return self

    def network(self, number: int) -> Network:
        return self.networks[number]


def _group_names(data: Dataset) -> list[str]:
    return data.names[-2:] if len(data) > 2 else ["end"]


def _tried(data, output, family, name, settings, number) -> tuple[Row, Network]:
    begin = time.perf_counter()
    if len(data) > 2:
        train, judge = data[: len(data) - 2], data[-2:]
    else:
        train, judge = hold_out(data, share=0.3)
    network = _made(train, output, settings)
    free, lost_ = _rows(judge, network, simulate(network, judge).value)
    one, _ = _rows(judge, network, predict(network, judge).value)
    groups = tuple(r.nrmse for r in free[1:])
    row = Row(
        output=output,
        number=number,
        family=family,
        name=name,
        free_run=free[0].nrmse,
        standard_error=float(np.std(groups) / 2)
        if len(groups) > 1 and None not in groups
        else 0.01,
        groups=groups,
        one_step=one[0].nrmse,
        diverged=lost_,
        operations=cost(network).multiplications,
        parameters=cost(network).parameters,
        seconds=round(time.perf_counter() - begin, 3),
        status="diverged" if lost_ else "ok",
    )
    return row, _made(data, output, settings)


def _rows(data, network, run):
    channels = tuple(network.output_channels)
    rows = score("", "", channels[0], collect(data, channels, run)[0])
    return rows, sum(r.diverged for r in rows[1:])


def _made(data: Dataset, output: str, settings: dict[str, Any]) -> Network:
    pool = Polynomial(
        outputs=(output,),
        input_lags=(1,),
        output_lags={output: (1,)},
        degree=settings.get("degree", 1),
    )
    chosen = select(
        make_pool(pool, data.channels),
        data,
        ForwardOLS(max_terms=settings["max_terms"]),
    )
    method = Identification().grow
    if "models" in settings:
        method = Lolimot(
            scheduling=[f"{data.channels.input_names[0]}[t]"],
            max_models=settings["models"],
        )
    return grow(chosen.value, data, method).value
