"""The contents of a file by asammdf; runs in a process of its own, see `mdf`."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxnarx.data.readers.columns import require_limit
from jaxnarx.data.readers.mdf_formula import apply_formula
from jaxnarx.errors import DataFileError, suggest

_GROUP_PATTERN = re.compile(r"(.+) @ group (\d+)")
_BUS_FLAGS = 0x2 | 0x4
"""Flags of groups that hold frames of a bus, not channels."""
_TO_TEXT = (7, 8, 11, 12)
"""Conversions that make text of numbers, in MDF 4 and in MDF 3."""
SHOWN_LABELS = 40
"""Labels of an enumeration that are told."""


def contents(path: Path, folder: Path) -> list[dict[str, Any]]:
    """Columns as keyword arguments of `Column`."""
    with _open_group(path) as mdf:
        found = list(_channels(mdf))
        names = [name for name, *_ in found]
        return [
            {
                "name": name if names.count(name) == 1 else f"{name} @ group {group}",
                "unit": _unit(mdf, group, index),
                "rows": int(mdf.groups[group].channel_group.cycles_nr),
                "table": f"group {group}",
                "step": _step(mdf, group),
            }
            for name, group, index in found
        ]


def signals(
    path: Path, folder: Path, *, wanted: list[str], max_bytes: float
) -> dict[str, Any]:
    """Values, validity and stamps of the wanted channels, as files of the folder."""
    with _open_group(path) as mdf:
        known: dict[str, list[tuple[int, int]]] = {}
        for name, group, index in _channels(mdf):
            known.setdefault(name, []).append((group, index))
        places = [_place(path, mdf, known, name) for name in wanted]
        count = sum(int(mdf.groups[g].channel_group.cycles_nr) for g, _ in places)
        require_limit(path, 24 * count, max_bytes)
        notes = _notes(path, mdf)
        for group in {group for group, _ in places}:
            _require_time(path, mdf, group)
        found, stamped = [], set()
        formulas = [_take_formula(mdf.groups[g].channels[c]) for g, c in places]
        asked = [(None, *place) for place in places]
        read = mdf.select(asked, copy_master=False, ignore_value2text_conversions=True)
        for k, (name, (group, index), formula, signal) in enumerate(
            zip(wanted, places, formulas, read, strict=True)
        ):
            if group not in stamped:
                np.save(folder / f"t{group}.npy", np.asarray(signal.timestamps, float))
                stamped.add(group)
            x, valid = _values(path, name, signal)
            if formula:
                x = _convert(path, name, formula, x)
            np.save(folder / f"x{k}.npy", x)
            if valid is not None:
                np.save(folder / f"valid{k}.npy", valid)
            found.append(
                {
                    "valid": valid is None,
                    "name": name,
                    "time": f"t{group}",
                    "unit": _unit(mdf, group, index),
                    "labels": _labels(mdf.groups[group].channels[index], x),
                }
            )
        return {"signals": found, "notes": notes}


def _open_group(path: Path) -> Any:
    from asammdf import MDF

    return MDF(path)


def _channels(mdf: Any) -> Iterator[tuple[str, int, int]]:
    """(name, group, place in it) of all channels but times, and but frames of buses."""
    for g, group in enumerate(mdf.groups):
        if _is_bus(group):
            continue
        for c, channel in enumerate(group.channels):
            if mdf.masters_db.get(g) != c and channel.name:
                yield str(channel.name), g, c


def _is_bus(group: Any) -> bool:
    return bool(int(getattr(group.channel_group, "flags", 0) or 0) & _BUS_FLAGS)


def _notes(path: Path, mdf: Any) -> list[str]:
    bus = sum(_is_bus(group) for group in mdf.groups)
    return [f"{path}: {bus} group(s) of bus frames are not read"] if bus else []


def _unit(mdf: Any, group: int, index: int) -> str:
    return str(mdf.get_channel_unit(group=group, index=index) or "").strip()


def _step(mdf: Any, group: int) -> float | None:
    """Median distance of the first stamps [s]."""
    if group not in mdf.masters_db:
        return None
    t = np.asarray(mdf.get_master(group, record_offset=0, record_count=200), float)
    return float(np.median(np.diff(t))) if len(t) > 1 else None


def _place(
    path: Path, mdf: Any, known: dict[str, list[tuple[int, int]]], name: str
) -> tuple[int, int]:
    """Group and place of a channel by its name."""
    found = known.get(name, [])
    match = _GROUP_PATTERN.fullmatch(name)
    if not found and match:
        found = [at for at in known.get(match[1], []) if at[0] == int(match[2])]
    if not found:
        found = [
            at for n, own in known.items() if n.split("\\")[0] == name for at in own
        ]
    if len(found) == 1:
        return found[0]
    if not found:
        raise DataFileError(
            f"{path}: there is no channel {name!r}. {suggest(name, known)}", path=path
        )
    told = [
        f"group {g} ({mdf.groups[g].channel_group.cycles_nr} samples"
        + (f" every {step:.4g} s)" if (step := _step(mdf, g)) else ")")
        for g, _ in found[:8]
    ]
    more = f" and {len(found) - 8} more" if len(found) > 8 else ""
    raise DataFileError(
        f"{path}: channel {name!r} is in {', '.join(told)}{more}. Say which by "
        f'column = "{name} @ group {found[0][0]}".',
        path=path,
    )


def _require_time(path: Path, mdf: Any, group: int) -> None:
    """DataFileError for a group that is not sampled over time."""
    master = mdf.masters_db.get(group)
    channel = None if master is None else mdf.groups[group].channels[master]
    kind = getattr(channel, "sync_type", 1)
    if channel is None or kind not in (0, 1):
        what = {2: "angles", 3: "distances", 4: "counts"}.get(kind, "nothing")
        raise DataFileError(
            f"{path}: group {group} is sampled over {what}, not over time. Choose "
            "channels of a group with a time.",
            path=path,
        )


def _values(path: Path, name: str, signal: Any) -> tuple[np.ndarray, np.ndarray | None]:
    """Numbers, and which of them are valid; `None` where all are."""
    x = signal.samples
    if x.dtype.kind in "SUO":
        told = sorted({_text(v) for v in np.unique(x)})
        shown = ", ".join(repr(t[:40]) for t in told[:8])
        raise DataFileError(
            f"{path}: channel {name} holds text: {shown}. Choose a numeric one.",
            path=path,
        )
    if x.ndim != 1 or x.dtype.kind not in "biuf":
        raise DataFileError(
            f"{path}: channel {name} holds arrays, not one number a sample. Leave it "
            "out.",
            path=path,
        )
    invalid = signal.invalidation_bits
    if invalid is None or not np.any(invalid):
        return np.asarray(x), None
    return np.asarray(x), ~np.asarray(invalid, bool)


def _take_formula(channel: Any) -> str:
    """The formula of a channel, which asammdf then does not evaluate; "" without one.

    Formulas that a table of labels refers to are taken away as well.
    """
    conversion, formula = channel.conversion, ""
    if conversion is None:
        return ""
    waiting = [conversion]
    while waiting:
        one = waiting.pop()
        waiting += [
            other
            for other in (getattr(one, "referenced_blocks", None) or {}).values()
            if hasattr(other, "conversion_type")
        ]
        if getattr(one, "formula", ""):
            formula = _text(one.formula) if one is conversion else formula
            one.formula = "X1"
    return formula


def _convert(path: Path, name: str, formula: str, x: np.ndarray) -> np.ndarray:
    try:
        return apply_formula(formula, x)
    except ValueError as error:
        raise DataFileError(
            f"{path}: channel {name} is converted by the formula {formula[:80]!r}, "
            f"which is not understood: {error}. Leave it out, or export it converted.",
            path=path,
        ) from None


def _labels(channel: Any, x: np.ndarray) -> list[str]:
    """The labels that an enumeration gives to its numbers."""
    conversion = channel.conversion
    if getattr(conversion, "conversion_type", 0) not in _TO_TEXT:
        return []
    levels = np.unique(x[:100_000])[:SHOWN_LABELS]
    told = np.asarray(conversion.convert(levels.astype(np.int64))).ravel()
    # in MDF 3 two of these numbers mean exponential and logarithm
    return [_text(v) for v in told] if told.dtype.kind in "SUO" else []


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
