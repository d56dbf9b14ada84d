"""The TOML description of a set of measured files, parsed.

Its keys are listed in `jaxnarx.settings.description`.
"""

import dataclasses
import reprlib
import string
import tomllib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from jaxnarx.data.channels import Channel, Channels, require_plain
from jaxnarx.data.missing import require_missing
from jaxnarx.data.readers.columns import Asked, CsvLayout
from jaxnarx.data.sampling import STATIC_ADVICE, positive_sample_time, require_time_unit
from jaxnarx.errors import DataFileError, SpecError, guard_reading, suggest
from jaxnarx.settings import Physics, from_dict, require_physics

PARTS = ("train", "validate", "test")
NO_PARTS = ("groups", "at_rest")
"""Keys of [records] that name no part."""


@dataclasses.dataclass(frozen=True)
class Description:
    """A parsed description: which columns of which files make which dataset.

    `columns` maps channel names to column names; `patterns` maps parts (`files`, or
    `train`, `validate`, `test`) to glob patterns, `groups` the names of what is left
    out together in cross-validation, `at_rest` patterns of files whose rows are
    operating points, measured when all had settled. `preparation` is a file, relative
    to the root, that tells how the files were made from raw ones. `physics` has the
    signs of gains and the longest time constants by output.
    """

    channels: Channels
    columns: Mapping[str, str]
    patterns: Mapping[str, tuple[str, ...]]
    sample_time: float | None
    time: str | None
    missing: str
    root: str
    layout: CsvLayout = CsvLayout()
    table: str = ""
    preparation: str | None = None
    time_unit: str | None = None
    groups: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    physics: Mapping[str, Physics] = dataclasses.field(default_factory=dict)
    at_rest: tuple[str, ...] = ()

    def require_time(self) -> None:
        """SpecError where nothing says when rows were taken; for files that do not."""
        if self.sample_time is None and self.time is None:
            raise SpecError(
                "[data] needs sample_time in seconds, or time, the name of a time "
                f"column. {STATIC_ADVICE}",
                field="data.sample_time",
            )

    @property
    def asked(self) -> Asked:
        """The settings that readers are given."""
        return Asked(self.layout, self.table, self.sample_time)

    @property
    def wanted(self) -> list[str]:
        """The columns to read: every channel's, and the time column."""
        return [*self.columns.values(), *([self.time] if self.time else [])]


def load_description(path: Path) -> Description:
    """Parse a description file.

    A file that is missing or no TOML is a DataFileError, a wrong setting a SpecError
    whose `field` names it; both name the file.
    """
    if path.suffix.lower() != ".toml":
        raise SpecError(
            f"{path}: read takes a TOML description that names channels, units, sample "
            "time and files; for arrays and frames see Dataset.from_arrays and "
            "Dataset.from_frame",
            field="path",
        )
    with guard_reading(path, "a description", advice="Correct it."):
        table = load_toml(path)
        try:
            return parse_description(table)
        except SpecError as error:
            raise SpecError(f"{path}: {error}", field=error.field) from error


def load_toml(path: Path) -> dict[str, Any]:
    """The table in a TOML file; one that is missing or no TOML is a DataFileError."""
    with guard_reading(path, "TOML", advice="Correct the file."):
        try:
            return tomllib.loads(path.read_text(encoding="utf-8-sig"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise DataFileError(
                f"{path}: not valid TOML: {error}.", path=path
            ) from error


_DATA_KEYS: dict[str, type] = {
    "root": str,
    "sample_time": float,
    "time": str,
    "time_unit": str,
    "missing": str,
    "columns": list,
    "decimal": str,
    "delimiter": str,
    "encoding": str,
    "skip_rows": int,
    "unit_row": bool,
    "table": str,
    "preparation": str,
}

_KIND_WORDS = {
    str: "text",
    float: "a number",
    list: "a list of text",
    int: "a whole number",
    bool: "true or false",
    dict: "a table",
}


def parse_description(table: Mapping[str, Any]) -> Description:
    """The description in an already parsed TOML table; SpecError names the field."""
    _require_keys(table, ("data", "channels", "records", "physics"), "")
    data = _section(table, "data")
    _require_keys(data, _DATA_KEYS, "data")
    settings = {
        k: _require_type(v, _DATA_KEYS[k], f"data.{k}") for k, v in data.items()
    }
    if "sample_time" in settings:
        positive_sample_time(settings["sample_time"])
    require_missing(settings.get("missing", "refuse"))
    require_time_unit(settings.get("time_unit"))
    channels, columns = _channels(_section(table, "channels"))
    records = _section(table, "records")
    preparation = settings.get("preparation")
    if preparation is not None and not _is_inside(preparation):
        raise SpecError(
            f"preparation must be a file in the data folder, got {preparation!r}",
            field="data.preparation",
        )
    return Description(
        channels=channels,
        columns=columns,
        patterns=_patterns(records),
        sample_time=settings.get("sample_time"),
        time=settings.get("time"),
        missing=settings.get("missing", "refuse"),
        root=settings.get("root", "."),
        layout=_layout(settings),
        table=settings.get("table", ""),
        preparation=preparation,
        time_unit=settings.get("time_unit"),
        groups=_groups(records.get("groups", {})),
        physics=_physics(table.get("physics", {}), channels),
        at_rest=tuple(
            _require_type(records.get("at_rest", []), list, "records.at_rest")
        ),
    )


def _is_inside(name: str) -> bool:
    """Whether a relative file name stays in its folder."""
    path = PurePosixPath(name)
    outside = path.is_absolute() or ".." in path.parts or "\\" in name
    return bool(path.name) and not outside


def _section(table: Mapping[str, Any], name: str) -> dict[str, Any]:
    if name not in table:
        raise SpecError(f"the section [{name}] is missing", field=name)
    return _require_type(table[name], dict, name)


def _require_keys(table, known, section: str):
    for key in table:
        if key not in known:
            where = f"[{section}]" if section else "the description"
            raise SpecError(
                f"{where} has the unknown key {key!r}. {suggest(key, known)}",
                field=f"{section}.{key}".strip("."),
            )


def _require_type(value: Any, kind: type, field: str) -> Any:
    """`value` if it has the TOML type `kind`; whole numbers serve as numbers."""
    good = type(value) is kind
    if kind is list:
        good = good and all(isinstance(v, str) for v in value)
    elif kind is float and type(value) is int:
        good = abs(value) < 1e300
    if not good:
        raise SpecError(
            f"{field} must be {_KIND_WORDS[kind]}, got {reprlib.repr(value)}",
            field=field,
        )
    return float(value) if kind is float else value


def _channels(section) -> tuple[Channels, dict[str, str]]:
    _require_keys(section, ("inputs", "outputs"), "channels")
    columns: dict[str, str] = {}
    groups = {"inputs": [], "outputs": []}
    for group, chosen in groups.items():
        field = f"channels.{group}"
        for name, value in _require_type(section.get(group, {}), dict, field).items():
            if isinstance(value, dict):
                _require_keys(value, ("column", "unit"), f"{field}.{name}")
            else:
                value = {"unit": value}
            unit = _require_type(value.get("unit", ""), str, f"{field}.{name}")
            column = value.get("column", name)
            columns[name] = _require_type(column, str, f"{field}.{name}.column")
            chosen.append(Channel(name, unit))
    channels = Channels(tuple(groups["inputs"]), tuple(groups["outputs"]))
    if not channels.outputs:
        raise SpecError(
            "[channels.outputs] is empty; name at least one output",
            field="channels.outputs",
        )
    return channels, columns


def _patterns(section) -> dict[str, tuple[str, ...]]:
    _require_keys(section, ("files", *PARTS, *NO_PARTS), "records")
    found = {
        k: tuple(_require_type(v, list, f"records.{k}"))
        for k, v in section.items()
        if k not in NO_PARTS
    }
    if "files" in found and len(found) > 1:
        raise SpecError(
            "[records] has files beside train, validate or test; use either",
            field="records.files",
        )
    if not any(found.values()):
        raise SpecError(
            'no file is named; give files = ["*.csv"] or train, validate and test',
            field="records",
        )
    order = ("files", *PARTS)
    return {part: found[part] for part in order if found.get(part)}


def _groups(value: Any) -> dict[str, tuple[str, ...]]:
    """Patterns by group; those of a list are called as their patterns."""
    field = "records.groups"
    if isinstance(value, dict):
        listed = {n: _require_type(v, list, f"{field}.{n}") for n, v in value.items()}
    elif isinstance(value, list) and all(isinstance(v, list) for v in value):
        patterns = [
            _require_type(v, list, f"{field}[{n}]") for n, v in enumerate(value)
        ]
        listed = {", ".join(own): own for own in patterns}
    else:
        raise SpecError(
            f'{field} must be lists of patterns by name, {{cold = ["day1_*"]}}, or a '
            f'list of such lists, [["day1_*"], ["day2_*"]], got {reprlib.repr(value)}',
            field=field,
        )
    for name, own in listed.items():
        require_plain(name, "names of groups", field=field)
        if not own or not name:
            raise SpecError(
                f"{field}: the group {name!r} has no pattern or no name", field=field
            )
    return {name: tuple(own) for name, own in listed.items()}


def _physics(value: Any, channels: Channels) -> dict[str, Physics]:
    """Read what is known of gains and time constants, by output."""
    table = _require_type(value, dict, "physics")
    found = {}
    for name, own in table.items():
        where = f"physics.{name}"
        found[name] = from_dict(Physics, _require_type(own, dict, where), where)
    require_physics(found, channels.input_names, channels.output_names)
    return found


_NO_DELIMITER = string.digits + string.ascii_letters + '"+-.\r\n\0'


def _layout(settings) -> CsvLayout:
    layout = CsvLayout(
        columns=tuple(settings.get("columns", ())),
        decimal=settings.get("decimal", "."),
        delimiter=settings.get("delimiter", ""),
        encoding=settings.get("encoding", "utf-8"),
        skip_rows=settings.get("skip_rows", 0),
        unit_row=settings.get("unit_row", False),
    )
    try:
        "a,1".encode(layout.encoding).decode(layout.encoding)
    except (LookupError, ValueError):
        raise SpecError(
            f"encoding {layout.encoding[:60]!r} is none for text; usual are "
            '"utf-8", "cp1252" and "utf-16"',
            field="data.encoding",
        ) from None
    if layout.decimal not in (".", ","):
        raise SpecError('decimal must be "." or ","', field="data.decimal")
    mark = layout.delimiter
    if mark and (len(mark) > 1 or mark in _NO_DELIMITER or mark == layout.decimal):
        raise SpecError(
            "delimiter must be one character, such as ; or a tab, other than the "
            f"decimal mark, got {mark!r}",
            field="data.delimiter",
        )
    if layout.skip_rows < 0:
        raise SpecError("skip_rows must not be negative", field="data.skip_rows")
    return layout
