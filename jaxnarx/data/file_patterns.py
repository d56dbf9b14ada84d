"""Files of a description: patterns, parts, and groups that are held out together."""

from collections.abc import Collection, Sequence
from pathlib import Path, PurePosixPath

from jaxnarx.data.crop import Cut, parse_cut, require_apart
from jaxnarx.data.description import Description
from jaxnarx.errors import DataFileError, SpecError


def find_files(
    description: Description, folder: Path, path: Path
) -> list[tuple[Path, Cut | None, str]]:
    """Every file with what is cut from it and its part, in order; rows in two parts are
    refused."""
    found = [
        (file, cut, part)
        for part, patterns in description.patterns.items()
        for file, cut in _choose_files(folder, patterns, part, path)
    ]
    require_apart(found, path)
    return found


def find_groups(
    description: Description,
    folder: Path,
    path: Path,
    found: list[tuple[Path, Cut | None, str]],
) -> dict[Path, str]:
    """The group of every training file that a pattern of the groups matches.

    All of the files `found` are training ones where none is stated to be. A pattern
    without any is a DataFileError, a file in two groups a SpecError.
    """
    training = {file for file, _, part in found if part == "train"}
    training = training or {file for file, *_ in found}
    groups: dict[Path, tuple[str, str]] = {}
    for name, patterns in description.groups.items():
        own = _choose_files(folder, patterns, f"groups.{name}", path, among=training)
        for (file, _), pattern in own.items():
            other, first = groups.setdefault(file, (name, pattern))
            if other != name:
                raise SpecError(
                    f"{path}: {file.name} is in the group {other!r} by {first!r} and "
                    f"in {name!r} by {pattern!r}. A record is left out with one group "
                    "only.",
                    field="records.groups",
                )
    return {file: name for file, (name, _) in groups.items()}


def _choose_files(
    folder: Path,
    patterns: Sequence[str],
    part: str,
    path: Path,
    among: Collection[Path] | None = None,
) -> dict[tuple[Path, Cut | None], str]:
    """The files of a part, and what is cut from each: each pattern adds some, or with
    "!" takes some away.

    With each comes the pattern that has chosen it. Others than `among` do not count.
    """
    chosen: dict[tuple[Path, Cut | None], str] = {}
    for pattern in patterns:
        bare, cut = parse_cut(pattern.removeprefix("!"), f"records.{part}")
        files = _glob(folder, bare, part, path)
        if among is not None:
            files = _training_files(files, pattern, among, part, path)
        if not pattern.startswith("!"):
            for file in files:
                chosen.setdefault((file, cut), pattern)
            continue
        if {file for file, _ in chosen}.isdisjoint(files):
            raise SpecError(
                f"{path}: {pattern!r} takes away files that no pattern before it has "
                "chosen. Write it after the patterns that it makes an exception of.",
                field=f"records.{part}",
            )
        chosen = {key: by for key, by in chosen.items() if key[0] not in files}
    if not chosen:
        raise SpecError(
            f"{path}: {part} has no file left, all are taken away by patterns with !.",
            field=f"records.{part}",
        )
    return chosen


def _training_files(
    files: list[Path], pattern: str, among: Collection[Path], part: str, path: Path
) -> list[Path]:
    own = [file for file in files if file in among]
    if not own:
        raise DataFileError(
            f"{path}: {pattern!r} (records.{part}) matches no training record, but "
            f"{files[0].name}. Groups are made of the records under train.",
            path=files[0],
        )
    return own


def _glob(folder: Path, pattern: str, part: str, path: Path) -> list[Path]:
    pure = PurePosixPath(pattern)
    if not pattern or pure.is_absolute() or ".." in pure.parts or "\\" in pattern:
        raise SpecError(
            f"{path}: the pattern {pattern!r} leaves the data folder {folder}. Write "
            "it relative to that folder, with /, and set root to a folder above all "
            "files.",
            field=f"records.{part}",
        )
    try:
        files = sorted(f for f in folder.glob(pattern) if f.is_file())
    except (ValueError, NotImplementedError) as error:
        raise SpecError(
            f"{path}: {pattern!r} is no pattern of files ({error})",
            field=f"records.{part}",
        ) from error
    if not files:
        raise DataFileError(
            f"{path}: no file matches {pattern!r} in {folder} (records.{part}). Check "
            "the pattern, and that the folder is the right one (root=..., or the "
            "environment variable JAXNARX_DATA).",
            path=folder / pattern,
        )
    for file in files:
        require_inside(file, folder, path, f"records.{part}")
    return files


def require_inside(file: Path, folder: Path, path: Path, field: str):
    """Nothing outside is read, whether by .., by an absolute name or by a link."""
    if not file.resolve().is_relative_to(folder.resolve()):
        raise SpecError(
            f"{path}: {field} names {file}, which is, or is a link to, a place outside "
            f"the data folder {folder}. Give as root a folder above all files.",
            field=field,
        )
