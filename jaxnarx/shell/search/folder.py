"""What a search's folder holds beside its candidates: origin, model and report."""

import dataclasses
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxnarx.data import Channels, Dataset, Preparation, Split, match_channels
from jaxnarx.errors import DataFileError, guard_reading
from jaxnarx.evaluation import Report, number, report
from jaxnarx.identification import (
    VALIDATION_GROUP,
    Leaderboard,
    SearchFolder,
    describe,
    with_group,
)
from jaxnarx.models import Network, combine_outputs, drop_outputs, save
from jaxnarx.settings import Physics
from jaxnarx.shell.messages import say, size
from jaxnarx.shell.output import write_report, write_text, write_together

ORIGIN_FILE = "made_from.json"
LEADERBOARD_FILE = "leaderboard.csv"


@dataclasses.dataclass(frozen=True)
class Origin:
    """The records of a search, for commands that come later; paths are absolute."""

    description: str
    root: str | None

    @classmethod
    def from_options(cls, description: str, root: str | None) -> "Origin":
        """The origin that was typed, or set as the folder of data."""
        root = root or os.environ.get("JAXNARX_DATA") or None
        return cls(os.path.abspath(description), root and os.path.abspath(root))

    def write(self, folder: Path) -> None:
        """Into the folder of the search."""
        write_text(folder / ORIGIN_FILE, json.dumps(dataclasses.asdict(self), indent=1))


def read_origin(folder: Path) -> Origin:
    """Read what `Origin.write` wrote; DataFileError where it is not there or
    damaged."""
    path = folder / ORIGIN_FILE
    if not path.is_file():
        raise DataFileError(
            f"{folder} does not say which records it was made from (it has no "
            f"{ORIGIN_FILE}); name them with --description",
            path=path,
        )
    with guard_reading(path, "the origin of a search", advice="Use --description."):
        told = json.loads(path.read_text(encoding="utf-8"))
        root = told.get("root")
        if not (isinstance(told["description"], str) and isinstance(root, str | None)):
            raise TypeError("paths are texts")
        return Origin(told["description"], root)


def search_records(split: Split) -> tuple[Dataset, Dataset | None]:
    """Records of the search, and those for validation, which join them."""
    train = split.train if split.train is not None else split.all
    say(f"{size(train)} for training")
    if split.validate is not None:
        say(
            f"The records for validation ({', '.join(split.validate.names[:6])}) join "
            "them as a group of their own"
        )
    return train, split.validate


def scored_parts(
    train: Dataset, validation: Dataset | None, test: Dataset | None, network: Network
) -> dict[str, Dataset]:
    """The parts of the report: all that was trained on, and the test records.

    A part without a record that is longer than the model's memory is left out.
    """
    joined = train
    if validation is not None:
        joined = with_group(train, validation, VALIDATION_GROUP)
    parts = {"train": joined} | ({} if test is None else {"test": test})
    known = network.channels
    longest = {name: max(map(len, data)) for name, data in parts.items()}
    for name in [n for n, rows in longest.items() if rows <= network.history + 1]:
        if len(parts) > 1:
            say(f"No record of {name} is longer than the model's memory; left out")
            del parts[name]
    own = Channels(known.inputs, known.outputs)
    return {name: match_channels(data, own)[0] for name, data in parts.items()}


def rivals(
    found: SearchFolder, outputs: Sequence[str], taken: Mapping[str, int]
) -> dict[str, Network]:
    """Other candidates to compare a model of the search with: the first linear one of
    its leaderboard and the first nonlinear one, neither of the family in use.

    Their names say so: on test records another candidate may be better.
    """
    tables = [describe(found.leaderboard, n, taken.get(n))["rows"] for n in outputs]
    networks = {}
    for linear, kind in ((True, "linear"), (False, "nonlinear")):
        firsts = [_find_first(rows, linear) for rows in tables]
        numbers = [row["number"] for row in firsts if row is not None]
        if len(numbers) < len(outputs) or not all(
            found.model_path(number).is_file() for number in numbers
        ):
            continue
        same = any(row["used"] and row["linear"] is linear for t in tables for row in t)
        name = f"first {kind} candidate" + same * " of another family"
        some = [found.network(number) for number in numbers]
        networks[name] = drop_outputs(
            some[0] if len(some) == 1 else combine_outputs(some)
        )
    return networks


def _find_first(rows: list[dict[str, Any]], linear: bool) -> dict[str, Any] | None:
    """The first row of that kind that is not of the family in use."""
    used = {row["family"] for row in rows if row["used"]}
    return next(
        (
            row
            for row in rows
            if row["linear"] is linear
            and row["free_run"] is not None
            and row["family"] not in used
        ),
        None,
    )


def score_model(
    network: Network,
    parts: Mapping[str, Dataset],
    found: SearchFolder,
    taken: Mapping[str, int],
    told: Mapping[str, Any],
    physics: Mapping[str, Physics] | None = None,
) -> Report:
    """The report of a model of the search; `taken` are candidates chosen by hand."""
    board = found.leaderboard
    shortest = min(max(map(len, data)) for data in parts.values())
    return report(
        network,
        parts,
        horizons=(1, 10) if shortest > network.history + 10 else (1,),
        leaderboard={
            name: describe(board, name, taken.get(name))
            for name in network.output_names
        },
        beside=_select_long_enough(rivals(found, network.output_names, taken), parts),
        physics=physics,
        provenance=told,
    )


def _select_long_enough(
    networks: Mapping[str, Network], parts: Mapping[str, Dataset]
) -> dict[str, Network]:
    """The networks whose memory every part has a record for."""
    longest = min(max(map(len, data)) for data in parts.values())
    return {
        name: network
        for name, network in networks.items()
        if longest > network.history + network.window + 1
    }


def write_run(
    folder: Path,
    network: Network,
    result: Report,
    about: Mapping[str, Any],
    board: Leaderboard | None = None,
) -> list[str]:
    """Model and report, and the table where it is new: together or not at all.

    Returns the names of the files.
    """
    with write_together(folder) as place:
        save(network, place / "model.safetensors", about=dict(about))
        write_report(result, place)
        if board is not None:
            write_text(place / LEADERBOARD_FILE, board.to_csv())
        return sorted(path.name for path in place.iterdir())


def provenance(
    typed: str, preparation: Preparation | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The provenance that the model file keeps, and that the report tells."""
    about: dict[str, Any] = {"command": typed}
    told: dict[str, Any] = {"command": typed}
    if preparation is not None:
        about["preparation"] = preparation.to_dict()
        told["preparation"] = preparation.describe()
    return about, told


def summary(result: Report) -> str:
    """Pooled figures of the main part: one step and free run of every output."""
    wide = max(len(channel.name) for channel in result.outputs)
    head = f"{'one step':>12s} {'free run':>12s} {'fit %':>8s}"
    lines = [f"On {result.main}: RMSE pooled over the records", f"{'':{wide}s} {head}"]
    for channel in result.outputs:
        one = result.pooled_row(channel.name, mode="one step")
        free = result.pooled_row(channel.name)
        cells = (
            row.status if row.rmse is None else number(row.rmse) for row in (one, free)
        )
        fit = "-" if free.fit is None else f"{free.fit:.1f}"
        one_text, free_text = cells
        lines.append(
            f"{channel.name:{wide}s} {one_text:>12s} {free_text:>12s} {fit:>8s}"
        )
    return "\n".join(lines)
