"""`jaxnarx leaderboard` and `jaxnarx choose`: what a search has found."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from jaxnarx.confidence import apply_release_limits, attach_domain_and_intervals
from jaxnarx.errors import SpecError
from jaxnarx.identification import (
    Candidate,
    SearchFolder,
    read_search,
    sentences,
)
from jaxnarx.models import Network, combine_outputs, drop_outputs
from jaxnarx.shell.commands.search import Choose, Leaderboard
from jaxnarx.shell.description import read_description
from jaxnarx.shell.exit_code import exit_code_of, require_finite
from jaxnarx.shell.messages import first_lines, say
from jaxnarx.shell.next_command import propose_simulation, tell_next
from jaxnarx.shell.output import RUN_FILES, run_folder
from jaxnarx.shell.search.folder import (
    Origin,
    provenance,
    read_origin,
    score_model,
    scored_parts,
    search_records,
    summary,
    write_run,
)
from jaxnarx.shell.search.leaderboard import TABLE_LEGEND, table


def show(command: Leaderboard) -> int:
    """Print the candidates of a search."""
    found = read_search(Path(command.run))
    board = found.leaderboard
    if command.csv:
        say(board.to_csv(), end="")
        return 0
    if not len(board):
        say("No candidate has been tried yet.")
    for n, output in enumerate(board.outputs):
        say("\n" * bool(n) + f"{output}: free run on records left out, NRMSE")
        say(table(board, output))
        for sentence in sentences(board, output):
            say(sentence)
    if len(board):
        say("\n" + "\n".join(TABLE_LEGEND))
    return 0


def choose(command: Choose, typed: str) -> int:
    """Write the model of other candidates, and the report on it."""
    require_finite("require_fit", command.require_fit)
    found = read_search(Path(command.run))
    rows = _rows(found, command.numbers)
    network = _network(found, rows)
    origin = _origin(command, found)
    split = read_description(origin.description, origin.root)
    about, told = provenance(typed, split.preparation)
    told["search"] = about["search"] = str(found.path)
    numbers = "-".join(str(row.number) for row in rows)
    out = command.out or f"{str(found.path).rstrip('/')}-{numbers}"
    with run_folder(out, "", force=command.force, marks=RUN_FILES) as folder:
        train, validation = search_records(split)
        parts = scored_parts(train, validation, split.test, network)
        network = attach_domain_and_intervals(
            apply_release_limits(network), parts["train"]
        )
        chosen = {row.output: row.number for row in rows}
        result = score_model(network, parts, found, chosen, told)
        following = propose_simulation(str(folder / RUN_FILES[0]))
        result = dataclasses.replace(result, next_command=following)
        files = write_run(folder, network, result, about)
    say("\n" + first_lines(result))
    say("\n" + summary(result))
    for row in rows:
        say(sentences(found.leaderboard, row.output, row.number)[0])
    say(f"\nwrote {', '.join(files)} to {folder}")
    say(f"\nOpen {folder / 'report.html'}")
    tell_next(following)
    return exit_code_of(result, command.require_fit)


def _rows(found: SearchFolder, numbers: Sequence[int]) -> list[Candidate]:
    """The candidates of these numbers; SpecError where two are of one output."""
    if not numbers:
        raise SpecError(
            "give the number of a candidate; `jaxnarx leaderboard` has them"
        )
    rows: dict[str, Candidate] = {}
    for number in numbers:
        row = found.row(number)
        if row.output in rows:
            raise SpecError(
                f"candidates {rows[row.output].number} and {number} are both of "
                f"{row.output}; choose one for each output"
            )
        rows[row.output] = row
    return list(rows.values())


def _network(found: SearchFolder, rows: Sequence[Candidate]) -> Network:
    networks = [found.network(row.number) for row in rows]
    whole = networks[0] if len(networks) == 1 else combine_outputs(networks)
    return drop_outputs(whole)


def _origin(command: Choose, found: SearchFolder) -> Origin:
    """The records; DataFileError where the ones of the search are gone."""
    if command.description is not None:
        return Origin.from_options(command.description, command.root)
    origin = read_origin(found.path)
    if not Path(origin.description).is_file():
        raise SpecError(
            f"{origin.description}, which {found.path} was made from, is not there any "
            "more; name it with --description"
        )
    return Origin(origin.description, command.root or origin.root)
