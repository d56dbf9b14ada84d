"""The search for the best model: outputs side by side, candidates one after another.

Outputs are searched in processes of their own where there are several and cores for
them. Results are written to disk after every candidate.
"""

import dataclasses
import functools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxnarx.confidence import apply_release_limits, attach_domain_and_intervals
from jaxnarx.data import Dataset, Groups, data_hash
from jaxnarx.data import groups as make_groups
from jaxnarx.files import TemporaryFolder
from jaxnarx.identification.candidates import CANDIDATES, Trying
from jaxnarx.identification.leaderboard import Candidate, Leaderboard
from jaxnarx.identification.search_folder import ROW_VERSION, SearchFolder, open_search
from jaxnarx.identification.time_budget import TimeBudget
from jaxnarx.identification.worker import OutputTask, SearchWorker, cores
from jaxnarx.models import Network, combine_outputs, make_pairs, set_bounds
from jaxnarx.partition import profile_data
from jaxnarx.settings import PARTITIONS, PRESETS, Physics, plain_value
from jaxnarx.simulation import match_records
from jaxnarx.solution import RESULTS, Solution

Tell = Callable[[dict[str, Any]], None]
NUMBERS_PER_OUTPUT = 1000
"""Numbers that the candidates of one output have."""
POLL_SECONDS = 0.2
"""Seconds between looks at what the processes have found."""


def search(
    data: Dataset,
    *,
    preset: str,
    budget: float | None,
    candidates: int | None,
    groups: Groups | None,
    outputs: Sequence[str],
    states: int | None,
    folder: Path | None,
    progress: Tell | None,
    physics: Mapping[str, Physics],
    at_rest: Dataset | None,
) -> Solution[Network]:
    """The best model by groups left out; see `jaxnarx.identify`."""
    tell = progress or (lambda event: None)
    begin = time.time()
    for name, own in physics.items():
        if own.signs:
            make_pairs(data, own, output=name)  # an error is told before any work
    profiles = {name: profile_data(data, name) for name in outputs}
    if groups is None:
        groups = make_groups(data, gap=max(one.memory for one in profiles.values()))
    rule = PRESETS[preset].rule
    board = Leaderboard((), groups.names, rule)
    key = {
        "data": data_hash(data),
        "preset": preset,
        "outputs": list(outputs),
        "groups": list(groups.names),
        "rows": ROW_VERSION,
    }
    if states is not None:
        key["states"] = states
    known = sorted(physics.items())
    if signs := {name: one.signs for name, one in known if one.signs}:
        key["physics"] = plain_value(signs)
    slow = {name: one.longest_time_constant for name, one in known}
    if slow := {name: one for name, one in slow.items() if one is not None}:
        key["longest time constants"] = slow
    if at_rest is not None:
        key["at_rest"] = data_hash(at_rest)
    linear = PRESETS[preset].linear
    added = {} if linear else CANDIDATES.added
    partitions = {} if linear else PARTITIONS.added
    if added or partitions:
        key["added"] = sorted([*added, *partitions])
    with TemporaryFolder() as place:
        store = open_search(place if folder is None else folder, key, board)
        tasks = {
            name: OutputTask(
                data,
                one,
                groups,
                preset,
                candidates,
                math.inf,
                tuple(r for r in store.leaderboard.rows if r.output == name),
                states,
                added,
                partitions,
                physics.get(name),
                at_rest,
            )
            for name, one in profiles.items()
        }
        until = math.inf if budget is None else begin + budget
        race = SearchRunner(store, list(outputs), tell, begin, until)
        stopped = False
        try:
            race.run(tasks)
        except KeyboardInterrupt:
            if not len(race.store.leaderboard):
                raise
            stopped = True
        facts = {n: k.to_dict(data.channels.input_names) for n, k in profiles.items()}
        found = _solution(race.store, list(outputs), stopped, race.late, facts)
        left = _held_out_errors(race.store.leaderboard, found.value, data)
        network = found.value
        if at_rest is not None:
            network = include_points(network, at_rest)
        network = attach_domain_and_intervals(
            apply_release_limits(network), data, groups, left
        )
        return dataclasses.replace(found, value=network)


def include_points(network: Network, at_rest: Dataset) -> Network:
    """The network whose ranges hold operating points too, in all that it knows.

    Candidates have the ranges of the records alone: what is summed and combined must
    have the same.
    """
    points, low, high = match_records(network, at_rest), network.low, network.high
    every = np.concatenate([r.signals for r in points])
    valid = np.concatenate([r.valid for r in points])
    inputs = len(points.channels.inputs)
    valid[~valid[:, inputs:].any(axis=1)] = False
    count = every.shape[1]
    least = np.min(every, axis=0, where=valid, initial=np.inf)
    most = np.max(every, axis=0, where=valid, initial=-np.inf)
    low = low.at[:count].min(least)
    high = high.at[:count].max(most)
    wider = set_bounds(dataclasses.replace(network, low=low, high=high))
    own = len(network.modelled)  # hidden channels keep their bounds
    lower = wider.lower.at[own:].set(network.lower[own:])
    upper = wider.upper.at[own:].set(network.upper[own:])
    return dataclasses.replace(wider, lower=lower, upper=upper)


class SearchRunner:
    """Candidates of all outputs as they come."""

    def __init__(
        self,
        store: SearchFolder,
        outputs: list[str],
        tell: Tell,
        begin: float,
        until: float,
    ):
        self.store, self.outputs, self.tell = store, outputs, tell
        self.begin, self.shares = begin, TimeBudget(until, 0, 1)
        self.late: list[str] = []
        """Outputs whose search the budget has ended."""

    def run(self, tasks: dict[str, OutputTask]) -> None:
        """Search every output."""
        places = {name: self.outputs.index(name) for name in tasks}
        tasks = {
            n: t for n, t in tasks.items() if not self.store.is_finished(places[n])
        }
        workers = min(cores(), len(tasks))
        self.shares = TimeBudget(self.shares.until, len(tasks), max(workers, 1))
        if workers < 2:
            for name, task in tasks.items():
                task = self._start_task(name, task)
                for tried in task.run(functools.partial(self.watch, name)):
                    self.add(name, *tried)
                self._finish(name, task)
        else:
            self._side_by_side(tasks)

    def _start_task(self, name: str, task: OutputTask) -> OutputTask:
        """The task with its share of the time."""
        return dataclasses.replace(task, until=self.shares.begin(name, time.time()))

    def watch(self, output: str, trying: Trying) -> None:
        """Tell what is being tried."""
        event = {
            "verb": "search",
            "output": output,
            "number": self._next_number(output),
        }
        chosen = self.store.leaderboard.choose(output)
        seconds = time.time() - self.begin
        self.tell(event | {"trying": trying, "chosen": chosen, "seconds": seconds})

    def _next_number(self, output: str) -> int:
        """Number of the next candidate of an output."""
        own = (r.number for r in self.store.leaderboard.rows if r.output == output)
        return 1 + max(own, default=NUMBERS_PER_OUTPUT * self.outputs.index(output))

    def add(self, output: str, row: Candidate, network: Network | None) -> None:
        """Keep one candidate and tell of it."""
        rows = self.store.leaderboard.rows
        same = [
            r
            for r in rows
            if (r.output, r.family, r.name) == (output, row.family, row.name)
        ]
        same_status = same and (row.eligible or row.status == same[0].status)
        if same_status and row.nested is None:
            return
        number = same[0].number if same else self._next_number(output)
        row = dataclasses.replace(row, number=number)
        self.store = self.store.add(row, network)
        board = self.store.leaderboard
        self.tell(
            {
                "verb": "search",
                "row": row,
                "chosen": board.choose(output),
                "done": len(board),
                "of": None,
                "seconds": time.time() - self.begin,
                "left": self.shares.seconds_left(time.time()),
            }
        )

    def _finish(self, name: str, task: OutputTask) -> None:
        """Say that an output needs no further look, unless time was short."""
        now = time.time()
        self.shares.finish(name, now)
        if now < task.until:
            self.store.finish(self.outputs.index(name))
        else:
            self.late.append(name)

    def _side_by_side(self, tasks: dict[str, OutputTask]) -> None:
        """A process for every output, as many at a time as there are cores."""
        waiting = list(tasks)
        running: dict[str, SearchWorker] = {}
        try:
            while waiting or running:
                while waiting and len(running) < self.shares.workers:
                    name = waiting.pop(0)
                    tasks[name] = self._start_task(name, tasks[name])
                    running[name] = SearchWorker(tasks[name])
                for name, side in list(running.items()):
                    ended = side.ended
                    for row, network in side.read_new():
                        self.add(name, row, network)
                    if (trying := side.read_trying()) is not None:
                        self.watch(name, trying)
                    if ended:
                        side.close()
                        del running[name]
                        self._finish(name, tasks[name])
                time.sleep(POLL_SECONDS)
        finally:
            for side in running.values():
                side.close()


def _held_out_errors(
    board: Leaderboard, network: Network, data: Dataset
) -> Float[np.ndarray, "outputs groups"] | None:
    """Free-run RMSE of every group left out, in the outputs' units; None where no
    candidate was fit to be chosen."""
    found = []
    for name in network.output_names:
        row, o = board.choose(name), data.channels.output_names.index(name)
        if row is None:
            return None
        seen = [r.valid[:, len(data.channels.inputs) + o] for r in data]
        y = [r.y[s, o] for r, s in zip(data, seen, strict=True)]
        errors = [np.nan if error is None else error for error in row.promised_groups]
        found.append(np.array(errors) * np.concatenate(y).std())
    return np.stack(found)


def _solution(
    store: SearchFolder,
    outputs: list[str],
    stopped: bool,
    late: list[str],
    facts: dict,
) -> Solution[Network]:
    """The chosen networks as one; the safest where all candidates are vetoed."""
    board, networks, vetoed = store.leaderboard, [], []
    for output in outputs:
        if not board.of(output):
            continue  # interrupted before
        row = board.choose(output)
        if row is None:
            vetoed.append(output)
            row = next((r for r in board.of(output) if r.family == "constant"), None)
        if row is not None:
            networks.append(store.network(row.number))
    status, detail = RESULTS.ok, ""
    if stopped:
        status, detail = RESULTS.budget_spent, "interrupted; the best so far"
        if missing := [name for name in outputs if name not in board.outputs]:
            detail += f", and none of {', '.join(missing)}"
    elif late:
        status = RESULTS.budget_spent
        detail = f"the budget ended the search of {', '.join(late)}; the best so far"
    if vetoed:
        status = RESULTS.diverged
        detail = f"every candidate of {', '.join(vetoed)} diverges"
    stats = {"leaderboard": board, "look": facts}
    return Solution(combine_outputs(networks), status, stats, detail)
