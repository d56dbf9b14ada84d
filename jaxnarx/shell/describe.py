"""The command `describe`: a TOML description of files as they are found."""

import json
import os
from collections.abc import Sequence
from pathlib import Path

from jaxnarx.data import (
    ChannelGuess,
    Run,
    Survey,
    measurement_files,
    read_split,
    survey,
)
from jaxnarx.errors import JaxnarxError, SpecError
from jaxnarx.files import write_whole
from jaxnarx.shell.commands import Describe
from jaxnarx.shell.messages import count, quote_command, say, size, warn
from jaxnarx.shell.next_command import tell_next


def describe(command: Describe) -> int:
    """Look, write, and read back; returns the exit code."""
    out = Path(command.out)
    if out.suffix.lower() != ".toml":
        raise SpecError(f"--out must be a TOML file, got {command.out}", field="out")
    if out.exists() and not command.force:
        raise SpecError(
            f"{out} is there already; choose another --out, or overwrite it with "
            "--force",
            field="out",
        )
    files = measurement_files([Path(path) for path in command.files])
    root = _root(files)
    say(f"Looking into {count(len(files), 'file')} in {_relative_path(root)}")
    found = survey(
        files,
        columns=command.columns,
        outputs=command.outputs,
        inputs=command.inputs,
        table=command.table or "",
        sample_time=command.sample_time,
    )
    say(summary(found))
    for role in ("input", "output"):
        if not found.of(role):
            raise SpecError(
                f"no channel looks like an {role}. Name some by --{role}s; known are "
                f"{', '.join(c.name for c in found.channels)}"
            )
    relative = os.path.relpath(root, out.resolve().parent)
    # The variable would send the reader elsewhere: then the folder is always given.
    given = "." if os.environ.get("JAXNARX_DATA") else Path(relative).as_posix()
    write_whole(out, toml(found, root, given).encode("utf-8"))
    say(f"\nwrote {out}")
    where = ["--root", str(root)] if given == "." and relative != "." else []
    check = ("jaxnarx", "check", str(out), *where)
    try:
        split = read_split(out, root=root if where else None)
    except JaxnarxError as error:
        warn(f"what it describes cannot be read yet: {error}")
        tell_next(quote_command(*check, remark=", when that is mended"))
        return 3
    say(size(split.all))
    for note in split.all.notes:
        say(note)
    tell_next(quote_command(*check))
    return 0


def _root(files: Sequence[Path]) -> Path:
    """The folder that holds all of them."""
    return Path(os.path.commonpath([file.resolve().parent for file in files]))


def _relative_path(folder: Path) -> Path:
    """The path relative to where the command runs, if it lies there."""
    here = Path.cwd()
    return folder.relative_to(here) if folder.is_relative_to(here) else folder


def summary(found: Survey) -> str:
    """A table of the channels, and what is remarkable."""
    rows = [("channel", "unit", "from", "to", "taken for", "because")]
    order = {"output": 0, "input": 1, "left out": 2}
    for one in sorted(found.channels, key=lambda c: order[c.role]):
        low, high = (f"{x:.4g}" if x == x else "" for x in (one.low, one.high))
        rows.append((one.name, one.unit, low, high, one.role, one.reason))
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    lines = [
        "  ".join(
            [cell.ljust(w) for cell, w in zip(row[:5], widths, strict=True)] + [row[5]]
        ).rstrip()
        for row in rows
    ]
    lines += [f"note: {remark}" for remark in found.remarks]
    lines += [f"warning: {text}" for text in found.odd.values()]
    lines += [
        f"the same cycle: {', '.join(run.name for run in own)}"
        for own in found.cycles
        if len(own) > 1
    ]
    if found.only_in:
        some, rest = list(found.only_in)[:8], len(found.only_in) - 8
        more = f" and {rest} more" if rest > 0 else ""
        lines.append(f"not in all files: {', '.join(some)}{more}")
    return "\n".join([*lines, *_options_to_add(found)])


def _options_to_add(found: Survey) -> list[str]:
    """The channels that are left out, and the options that add the first of them."""
    left = [one.name for one in found.of("left out")]
    if not left:
        return []
    inputs = [one.name for one in found.of("input")]
    outputs = [one.name for one in found.of("output")]
    options = quote_command("--outputs", *outputs, "--inputs", *inputs, left[0])
    return [f"left out: {', '.join(left)}; to add {left[0]}: {options}"]


def toml(found: Survey, root: Path, relative: str) -> str:
    """The description, every key explained, the others named."""
    lines = [
        "# Written by `jaxnarx describe`; correct what it has guessed wrongly.",
        "# All keys: jaxnarx check --help",
        "",
        "[data]",
        f"root = {_text(relative)}  # folder of the files, as seen from this one",
        *_time(found),
        *_missing_lines(found),
        *_layout(found),
        "",
        "[channels.inputs]  # what moves the engine; name = unit",
        *(_channel(c) for c in found.of("input")),
        "",
        "[channels.outputs]  # what is to be modelled",
        *(_channel(c) for c in found.of("output")),
        *_unused_channels(found),
        "",
        "[records]  # files, or patterns such as day1/*.csv; !pattern takes some away",
        *_records(found, root),
    ]
    return "\n".join(lines) + "\n"


def _text(value: str) -> str:
    """A TOML string."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _time(found: Survey) -> list[str]:
    lines = []
    if found.time:
        lines.append(f"time = {_text(found.time)}  # the column that tells the time")
        if found.time_unit:
            lines.append(f"time_unit = {_text(found.time_unit)}  # by its steps")
        if found.sample_time is None:
            lines.append("# sample_time = 0.1  # s; by default as that column says")
    if found.sample_time is not None:
        told = "  # s"
        if any(c.step for c in found.channels):
            told += "; channels with other rasters are brought to it"
        lines.append(f"sample_time = {found.sample_time!r}{told}")
    return lines


def _missing_lines(found: Survey) -> list[str]:
    gaps = [c for c in found.channels if c.missing > 0 and c.role != "left out"]
    if not gaps:
        return ['# missing = "mask"  # or "split", "interpolate"; default: refuse']
    told = ", ".join(f"{c.name} {c.missing:.2%}" for c in gaps[:5])
    return [f'missing = "mask"  # samples that are not valid: {told}']


def _layout(found: Survey) -> list[str]:
    lines, layout = [], found.layout
    if layout.columns:
        lines.append(f"columns = [{', '.join(map(_text, layout.columns))}]")
    if found.table:
        lines.append(f"table = {_text(found.table)}  # the sheet, variable or group")
    if layout.decimal != ".":
        lines.append(f"decimal = {_text(layout.decimal)}")
    if layout.delimiter not in ("", ","):
        lines.append(f"delimiter = {_text(layout.delimiter)}")
    if layout.encoding != "utf-8":
        lines.append(f"encoding = {_text(layout.encoding)}")
    if layout.skip_rows:
        lines.append(f"skip_rows = {layout.skip_rows}  # lines before the names")
    if layout.unit_row:
        lines.append("unit_row = true  # a line of units follows the names")
    return lines


def _channel(one: ChannelGuess) -> str:
    what = _text(one.unit)
    if one.channel != one.name:
        what = f"{{column = {_text(one.name)}, unit = {what}}}"
    told = f"# {one.low:.4g} to {one.high:.4g}; {one.reason}"
    return f"{_text(one.channel)} = {what}  {told}"


def _unused_channels(found: Survey) -> list[str]:
    left = found.of("left out")
    lines = [f"# {_text(c.name)} = {_text(c.unit)}  # {c.reason}" for c in left]
    return ["", "# Left out:", *lines] if left else []


def _records(found: Survey, root: Path) -> list[str]:
    def names(runs: Sequence[Run]) -> str:
        return f"[{', '.join(map(_text, _patterns(runs, root)))}]"

    odd = [f"# look at this record: {text}" for text in found.odd.values()]
    lines = odd + [f"{part} = {names(runs)}" for part, runs in found.parts.items()]
    if "files" in found.parts:
        lines.append("# test = [...]  # records that only judge, if there are others")
        return lines
    lines.insert(0, "# test records only judge: no choice sees them")
    if any(run.span for run in found.parts["train"]):
        lines.insert(1, "# seconds of one record: correct them as its course asks")
    training = set(found.parts["train"])
    tied = [own for own in found.cycles if len(own) > 1 and set(own) <= training]
    if tied:
        groups = ", ".join(names(own) for own in tied)
        lines.append(f"groups = [{groups}]  # the same cycle: left out together")
    return lines


def _patterns(runs: Sequence[Run], root: Path) -> list[str]:
    """The patterns of some records, numbered ones of a file together."""
    files: dict[str, list[Run]] = {}
    for run in runs:
        name = run.file.resolve().relative_to(root).as_posix()
        files.setdefault(name, []).append(run)
    told = []
    for name, own in files.items():
        members = ",".join(run.member for run in own if run.member)
        behind = [f" @ #{members}"] if members else [run.behind for run in own]
        told += [name + one for one in behind]
    return told
