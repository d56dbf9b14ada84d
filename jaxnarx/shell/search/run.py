"""`jaxnarx identify` without a method: the search, from description to report."""

import dataclasses
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from jaxnarx.data import Channels, Dataset
from jaxnarx.errors import JaxnarxError, SpecError, suggest
from jaxnarx.formatting import list_names
from jaxnarx.identification import (
    CANDIDATES_FOLDER,
    SEARCH_FILE,
    Leaderboard,
    identify,
    read_search,
    sentences,
)
from jaxnarx.models import Network, drop_outputs
from jaxnarx.settings import Physics
from jaxnarx.shell import interrupt
from jaxnarx.shell.commands import Identify
from jaxnarx.shell.commands.search import Automatic
from jaxnarx.shell.description import read_description, tell_findings
from jaxnarx.shell.exit_code import exit_code_of, require_finite
from jaxnarx.shell.messages import count, first_lines, quote_command, say, warn
from jaxnarx.shell.next_command import propose_after_search, tell_next
from jaxnarx.shell.output import RUN_FILES, run_folder, slug
from jaxnarx.shell.report.page import exported_cost
from jaxnarx.shell.search.folder import (
    LEADERBOARD_FILE,
    ORIGIN_FILE,
    Origin,
    provenance,
    score_model,
    scored_parts,
    search_records,
    summary,
    write_run,
)
from jaxnarx.shell.search.leaderboard import CANDIDATES_SHOWN, TABLE_LEGEND, table
from jaxnarx.shell.search.progress import duration, search_progress
from jaxnarx.solution import Solution

OUTPUTS_IN_NAME = 3
"""Outputs that the name of a folder names."""
CONTINUATION_TEXT = "the same command goes on where it stopped"


def search(command: Identify, asked: Automatic, typed: str) -> int:
    """Search, or go on searching, and report on the model; returns the exit code."""
    begin = time.perf_counter()
    require_finite("require_fit", command.require_fit)
    split = read_description(command.description, command.root)
    require_outputs(asked, split.all.channels)
    about, told = provenance(typed, split.preparation)
    if split.preparation is not None:
        say(f"The records are prepared:\n{told['preparation']}")
    out = command.out or str(Path("runs") / folder_name(command, asked))
    with _search_folder(out, command.force) as folder:
        train, validation = search_records(split)
        tell_findings(train)
        Origin.from_options(command.description, command.root).write(folder)
        physics, points = _chosen_physics(asked, split.physics), split.at_rest
        if points is not None:
            files = list_names(points.names)
            say(f"{count(points.samples, 'operating point')} at rest, of {files}")
        known = {"physics": physics, "at_rest": points}
        fit, stopped = _run(asked, train, validation, folder, known)
        network, board = drop_outputs(fit.value), fit.stats["leaderboard"]
        parts = scored_parts(train, validation, split.test, network)
        if look := fit.stats.get("look"):
            told["seen in the data"] = look
        result = score_model(network, parts, read_search(folder), {}, told, physics)
        model = str(folder / RUN_FILES[0])
        judgement = None if stopped else result.verdict
        following = propose_after_search(command, asked, judgement, model=model)
        result = dataclasses.replace(result, next_command=following)
        files = write_run(folder, network, result, about, board)
    say("\n" + first_lines(result))
    say("\n" + summary(result))
    spent = duration(time.perf_counter() - begin)
    say(f"\n{spent}; wrote {_join_names(files)} to {folder}")
    _tell(board, network, quote_command("jaxnarx", "leaderboard", str(folder)))
    _tell_end(fit, stopped)
    _tell_missing(asked, train.channels, network)
    say(f"\nOpen {folder / 'report.html'}")
    tell_next(following)
    status = exit_code_of(result, command.require_fit)
    return 130 if stopped else status


def folder_name(command: Identify, asked: Automatic) -> str:
    """Always the same for the same description, outputs and preset."""
    words = [Path(command.description).stem, *asked.outputs[:OUTPUTS_IN_NAME]]
    if len(asked.outputs) > OUTPUTS_IN_NAME:
        words.append(f"{len(asked.outputs) - OUTPUTS_IN_NAME}_more")
    return slug("-".join([*words, asked.preset]))


def require_outputs(asked: Automatic, channels: Channels) -> None:
    """SpecError where there is no output of a name that is asked for."""
    known = channels.output_names
    for name in asked.outputs:
        if name not in known:
            raise SpecError(
                f"outputs: there is no output {name!r}. {suggest(name, known)}",
                field="outputs",
            )


@contextmanager
def _search_folder(out: str, force: bool) -> Iterator[Path]:
    """The folder, which is gone on with where it holds a search; with `force` it is
    begun anew. Without any candidate nothing of ours stays in it.
    """
    goes_on = (Path(out) / SEARCH_FILE).is_file()
    marks = (*RUN_FILES, LEADERBOARD_FILE)
    with run_folder(out, "", force=force or goes_on, marks=marks) as folder:
        if force:
            _clear(folder)
        try:
            with interrupt.last_words(lambda: _tell_kept(folder)):
                yield folder
        except BaseException as error:
            if not _count_candidates(folder):
                _clear(folder)
            elif (
                isinstance(error, KeyboardInterrupt) or interrupt.requested_exit_code()
            ):
                _tell_kept(folder)
            raise


def _clear(folder: Path) -> None:
    for name in (SEARCH_FILE, ORIGIN_FILE):
        with suppress(FileNotFoundError):
            (folder / name).unlink()
    shutil.rmtree(folder / CANDIDATES_FOLDER, ignore_errors=True)


def _count_candidates(folder: Path) -> int:
    """The number of candidates in the folder."""
    try:
        return len(read_search(folder).leaderboard)
    except JaxnarxError:
        return 0


def _run(
    asked: Automatic,
    train: Dataset,
    validation: Dataset | None,
    folder: Path,
    known: Mapping[str, Any],
) -> tuple[Solution[Network], bool]:
    """The search, and whether Ctrl-C has ended it; `known` is what there is beside
    records."""
    if there := _count_candidates(folder):
        say(f"Going on with {count(there, 'candidate')} in {folder}")

    def tell_ending() -> None:
        warn("ending with the best so far; Ctrl-C again ends at once")

    with (
        interrupt.finish_on_interrupt(tell_ending) as patience,
        search_progress() as progress,
    ):
        fit = identify(
            train,
            preset=asked.preset,
            budget=asked.budget,
            candidates=asked.candidates,
            outputs=asked.outputs,
            states=asked.states,
            validation=validation,
            folder=folder,
            progress=progress,
            **known,
        )
    return fit, patience.used


def _chosen_physics(
    asked: Automatic, physics: Mapping[str, Physics]
) -> dict[str, Physics]:
    """What physics says of the outputs that are asked for; it is told."""
    wanted: Any = asked.outputs or physics
    chosen = {name: one for name, one in physics.items() if name in wanted}
    if chosen:
        told = "; ".join(f"{name} {one}" for name, one in chosen.items())
        say(f"By physics: {told}")
    return chosen


def _tell_kept(folder: Path) -> None:
    if there := _count_candidates(folder):
        say(f"  {count(there, 'candidate')} kept in {folder}; {CONTINUATION_TEXT}")


def _tell(board: Leaderboard, network: Network, command: str) -> None:
    """The first rows of every output, the choice and why; `command` shows all."""
    for output in network.output_names:
        say(f"\n{output}: free run on records left out, NRMSE")
        say(table(board, output, top=CANDIDATES_SHOWN, command=command))
        for sentence in sentences(board, output):
            say(sentence)
    say("\n" + "\n".join(TABLE_LEGEND))
    say(f"All candidates: {command}")
    if cost := exported_cost(network):
        say(f"The exported model takes {cost}")


def _tell_end(fit: Solution[Network], stopped: bool) -> None:
    if stopped:
        warn(f"interrupted: this is the best so far, and {CONTINUATION_TEXT}")
    elif fit.detail:
        (say if fit.is_okay else warn)(f"{fit.status_name}: {fit.detail}")


def _tell_missing(asked: Automatic, channels: Channels, network: Network) -> None:
    wanted: Any = asked.outputs or channels.output_names
    if missing := [name for name in wanted if name not in network.output_names]:
        warn(f"not reached: {', '.join(missing)}; {CONTINUATION_TEXT}")


def _join_names(names: list[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"
