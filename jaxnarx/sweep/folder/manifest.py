"""The manifest of a run folder: which sweep it holds, so that no other mixes in."""

import dataclasses
import datetime
import hashlib
import importlib.metadata
import json
import os
import platform
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxnarx.errors import DataFileError, SpecError, guard_reading
from jaxnarx.sweep.folder.files import put
from jaxnarx.sweep.work import Work

MANIFEST_FILE = "manifest.json"
FORMAT_VERSION = 1
RECORDED_PACKAGES = (
    "jaxnarx",
    "jax",
    "jaxlib",
    "equinox",
    "optimistix",
    "numpy",
    "pyarrow",
)
SHOWN_DIFFERENCES = 5
"""Differences that a refusal names one by one."""
_RESTORE_ADVICE = (
    "Restore it, or begin anew with new=True (--new-run), which sets the folder aside."
)


@dataclasses.dataclass(frozen=True)
class Manifest:
    """The manifest of a run folder: work, data, chunks.

    `sweep` is what must not change: what the work says of itself, a digest of its
    labels, their number, whether numbers are of 64 bits and the version of this
    package; the size of the chunks it began with is kept with it. `about` is what may:
    other versions, the machine, the date.
    """

    sweep: dict[str, Any]
    about: dict[str, Any]

    @property
    def digest(self) -> str:
        """SHA-256 of what must not change; every file of results carries it."""
        return sha256(self.sweep)

    @property
    def members(self) -> int:
        """Number of members."""
        return self.sweep["members"]

    @property
    def chunk(self) -> int:
        """Members of a chunk; the last one may have fewer."""
        return self.sweep["chunk"]


def sha256(value: Any) -> str:
    """SHA-256 of a value as canonical JSON; SpecError where it is none."""
    return hashlib.sha256(_canonical(value).encode()).hexdigest()


def make_manifest(work: Work, *, chunk: int, float64: bool) -> Manifest:
    """The manifest of a sweep that begins now on this machine."""
    versions = _versions()
    labels = work.members
    sweep = {
        "work": work.describe(),
        "labels": sha256(labels),
        "members": len(labels),
        "chunk": chunk,
        "float64": float64,
        "jaxnarx": versions["jaxnarx"],
    }
    about = {
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": versions,
        "machine": platform.platform(),
        "processors": os.cpu_count(),
    }
    return Manifest(json.loads(_canonical(sweep)), about)


def write_manifest(folder: Path, manifest: Manifest) -> bool:
    """Write it unless the folder has one already."""
    value = {"format": FORMAT_VERSION, "sha256": manifest.digest}
    value |= dataclasses.asdict(manifest)
    return put(folder / MANIFEST_FILE, json.dumps(value, indent=1).encode())


def read_manifest(folder: Path) -> Manifest:
    """Read a folder's manifest; DataFileError where it is foreign or damaged."""
    path = folder / MANIFEST_FILE
    if not path.is_file():
        raise DataFileError(
            f"{folder} is no run folder of a sweep: it has no {MANIFEST_FILE}",
            path=path,
        )
    with guard_reading(path, "the manifest of a sweep", advice=_RESTORE_ADVICE):
        value = json.loads(path.read_text(encoding="utf-8"))
        if value["format"] == FORMAT_VERSION:
            manifest = Manifest(value["sweep"], value["about"])
            if manifest.digest != value["sha256"]:
                raise ValueError("its digest does not fit it")
            sizes = (manifest.members, manifest.chunk)
            if not all(type(n) is int and 0 < n < 2**31 for n in sizes):
                raise ValueError("its numbers are none of a sweep")
            return dataclasses.replace(manifest, about=dict(value["about"]))
    raise DataFileError(
        f"{path} has format {value['format']}; this program knows {FORMAT_VERSION}. "
        "Continue with the version of jaxnarx that began it, or begin anew with "
        "new=True (--new-run).",
        path=path,
    )


def require_same(folder: Path, found: Manifest, asked: Manifest) -> None:
    """SpecError that names what differs between the folder's sweep and this one.

    Its chunks are the folder's business: another size is no other sweep.
    """
    same = asked.sweep | {"chunk": found.chunk}
    asked = dataclasses.replace(asked, sweep=same)
    if found.digest == asked.digest:
        return
    told = list(
        _differences(_without_digest(found.sweep), _without_digest(asked.sweep))
    )
    told = told or ["the labels of its members are others"]
    more = (
        f" and {len(told) - SHOWN_DIFFERENCES} more"
        if len(told) > SHOWN_DIFFERENCES
        else ""
    )
    raise SpecError(
        f"{folder} holds another sweep: {'; '.join(told[:SHOWN_DIFFERENCES])}{more}. "
        "Continue it as it was, choose another folder, or begin anew with new=True "
        "(--new-run), which sets the old one aside.",
        field="folder",
    )


def other_versions(found: Manifest) -> list[str]:
    """Packages that have changed since the sweep began, as sentences."""
    now, then = _versions(), found.about.get("versions")
    then = then if isinstance(then, Mapping) else {}
    return [
        f"{name} was {then.get(name)} when the sweep began and is {now[name]}"
        for name in now
        if then.get(name) != now[name]
    ]


def _canonical(value: Any) -> str:
    try:
        return json.dumps(value, sort_keys=True)
    except TypeError as error:
        raise SpecError(
            f"the description and labels of a sweep must be plain JSON values: {error}",
            field="work",
        ) from error


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in RECORDED_PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:  # run from a source folder
            found[name] = "unknown"
    return found


def _differences(old: Any, new: Any, path: str = "") -> Iterator[str]:
    """The differences of two JSON values, as `work.ridge was 1, is 2`."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in dict.fromkeys((*old, *new)):
            name = f"{path}.{key}" if path else str(key)
            yield from _differences(old.get(key), new.get(key), name)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, (one, other) in enumerate(zip(old, new, strict=True)):
            yield from _differences(one, other, f"{path}[{i}]")
    elif old != new:
        name = path.removeprefix("work.")
        yield f"{name} was {_short(old)}, is {_short(new)}"


def _without_digest(sweep: dict[str, Any]) -> dict[str, Any]:
    """Drop the digest of the labels, which tells people nothing."""
    return {name: value for name, value in sweep.items() if name != "labels"}


def _short(value: Any, width: int = 40) -> str:
    text = json.dumps(value)
    return text if len(text) <= width else text[: width - 1] + "…"
