"""A search that costs nothing, for the tests of what is told and written around it."""

import dataclasses
import signal
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.data import Dataset
from jaxnarx.identification import Candidate, Leaderboard
from jaxnarx.identification.search_folder import SearchFolder, open_search
from jaxnarx.models import Network, assemble, combine_outputs, global_model
from jaxnarx.regressors import polynomial_pool
from jaxnarx.solution import RESULTS, Solution

NAMES = ("day 1", "day 2")
"""Groups of records."""
KINDS = (
    ("constant", "mean", (0.9, 1.1), 0),
    ("ARX", "order 1", (0.35, 0.25), 3),
    ("polynomial", "degree 2", (0.18, 0.22), 9),
    ("shared feedback", "2 regions", (0.20, 0.19), 20),
    ("LOLIMOT", "3 models", None, 30),
)
"""Family, name, errors in the groups (None: it diverges) and operations."""


def row(kind: int, number: int = 0, output: str = "y") -> Candidate:
    """The candidate of a kind."""
    family, name, errors, operations = KINDS[kind]
    pooled = None if errors is None else float(np.mean(errors))
    return Candidate(
        output=output,
        number=number or kind + 1,
        family=family,
        name=name,
        free_run=pooled,
        standard_error=None if pooled is None else 0.02,
        groups=errors or (0.3, None),
        one_step=0.01,
        diverged=int(errors is None),
        operations=operations,
        parameters=operations + 1,
        seconds=1.5,
        status="ok" if errors else "diverged",
    )


def board(*outputs: str, rule: str = "near") -> Leaderboard:
    """All kinds for every output."""
    rows = [
        row(k, len(KINDS) * o + k + 1, name)
        for o, name in enumerate(outputs)
        for k in range(len(KINDS))
    ]
    return Leaderboard(tuple(rows), NAMES, rule)


def fitted(data: Dataset, output: str, *, linear: bool = True) -> Network:
    """Least squares one step ahead on the last sample of everything, or the mean."""
    pool = polynomial_pool(
        data.channels,
        outputs=[output],
        input_lags=(1,),
        output_lags={output: (1,)},
        degree=1,
    )
    o = len(data.channels.inputs) + pool.outputs[0]
    at = [signal for signal, _ in pool.variables]
    x = np.concatenate([r.signals[:-1, at] for r in data]) * linear
    y = np.concatenate([r.signals[1:, o] for r in data])
    x = np.concatenate([np.ones((len(x), 1)), x], axis=1)
    theta = np.linalg.lstsq(x, y, rcond=None)[0]
    gain = np.ones(len(data.channels.names))
    model = global_model(np.arange(x.shape[1], dtype=np.int32)[:, None], theta)
    return assemble(pool, data, gain, [model])


@dataclasses.dataclass
class FakeSearch:
    """What `jaxnarx.identification.search.search` promises, its models made up."""

    tried: list[str] = dataclasses.field(default_factory=list)
    stop_after: int | None = None
    """Candidates after which Ctrl-C comes."""
    vetoed: bool = False
    error: Exception | None = None
    options: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __call__(
        self,
        data,
        *,
        preset,
        budget,
        candidates,
        groups,
        outputs,
        states,
        folder,
        progress,
        physics,
        at_rest,
    ) -> Solution[Network]:
        self.options = {"preset": preset, "budget": budget, "candidates": candidates}
        self.options |= {"physics": physics} if physics else {}
        self.options |= {"at_rest": at_rest} if at_rest is not None else {}
        self.options["groups"] = [record.group for record in data]
        key = {"preset": preset, "records": data.names, "outputs": outputs}
        if self.error is not None:
            raise self.error
        store = open_search(Path(folder), key, Leaderboard((), NAMES))
        stopped = False
        try:
            store = self._run(store, data, outputs, candidates, progress)
        except KeyboardInterrupt:
            store = open_search(Path(folder), key, Leaderboard((), NAMES))
            if not len(store.leaderboard):
                raise
            stopped = True
        return self._solution(store, outputs, stopped)

    def _run(self, store: SearchFolder, data, outputs, candidates, progress):
        for o, output in enumerate(outputs):
            for k in range(len(KINDS))[:candidates]:
                one = row(k, len(KINDS) * o + k + 1, output)
                if any(r.number == one.number for r in store.leaderboard):
                    continue
                if self.stop_after == len(self.tried):
                    signal.raise_signal(signal.SIGINT)
                self.tried.append(f"{output}: {one.family}")
                if self.vetoed:
                    lost = {"free_run": None, "status": "diverged", "diverged": 1}
                    one = dataclasses.replace(one, **lost)
                store = store.add(one, fitted(data, output, linear=k > 0))
                progress(
                    {
                        "verb": "search",
                        "row": one,
                        "chosen": store.leaderboard.choose(output),
                        "done": len(store.leaderboard),
                        "of": None,
                        "seconds": 1.0,
                        "left": 70.0,
                    }
                )
        return store

    def _solution(self, store: SearchFolder, outputs, stopped) -> Solution[Network]:
        found = store.leaderboard
        rows = [found.choose(o) or found.of(o)[0] for o in found.outputs]
        status = RESULTS.budget_spent if stopped else RESULTS.ok
        status = RESULTS.diverged if self.vetoed else status
        stats = {"leaderboard": found, "look": {o: {"memory": 9} for o in outputs}}
        network = combine_outputs([store.network(r.number) for r in rows])
        return Solution(network, status, stats, "so it ended")
