"""The public names: where each is described, and how it stands in the source."""

import ast
import dataclasses
import functools
import importlib
import inspect
import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

import jaxnarx

PACKAGE = Path(jaxnarx.__file__).parent
ROOMS = tuple(sorted(set(dir(jaxnarx)) - set(jaxnarx.__all__)))
"""Rooms that are offered as such; of all others only names for every day are."""


@dataclasses.dataclass(frozen=True)
class Name:
    """A public name: `path` is where it is described, `page` the room whose page it
    stands on; `also` are the other places that offer the same thing."""

    path: str
    page: str
    value: Any
    also: tuple[str, ...] = ()

    @property
    def everyday(self) -> bool:
        """Whether it stands at the top of the package."""
        return self.path.count(".") == 1


def offered(room: str) -> list[str]:
    """Names that a room offers: its `__all__`, else what its `__init__` takes in."""
    module = importlib.import_module(f"jaxnarx.{room}")
    listed = getattr(module, "__all__", None)
    if listed is not None:
        return sorted(listed)
    found = []
    for node in ast.parse(Path(module.__file__ or "").read_text("utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            found += [a.asname for a in node.names if a.asname == a.name]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found.append(node.target.id)
    return sorted(name for name in found if not name.startswith("_"))


@functools.cache
def public() -> tuple[Name, ...]:
    """Every public name once, in the order of the pages."""
    home = {
        name: page
        for page, names in jaxnarx._ROOM_NAMES.items()  # noqa: SLF001
        for name in names.split()
    }
    places = [(f"jaxnarx.{n}", home[n], getattr(jaxnarx, n)) for n in jaxnarx.__all__]
    # The settings of special ends are offered where they belong, and all together.
    for room in sorted(ROOMS, key=lambda room: room == "settings"):
        module = importlib.import_module(f"jaxnarx.{room}")
        places += [
            (f"jaxnarx.{room}.{n}", room, getattr(module, n)) for n in offered(room)
        ]
    first: dict[Any, Name] = {}
    for path, page, value in places:
        key = id(value) if described(value) else path
        if key in first:
            known = first[key]
            first[key] = dataclasses.replace(known, also=(*known.also, path))
        else:
            first[key] = Name(path, page, value)
    return tuple(first.values())


def described(value: Any) -> bool:
    """Whether it tells itself what it is: a class, a function, a module."""
    return isinstance(value, type | ModuleType) or callable(value)


def modules_of(names: Iterable[Name]) -> list[str]:
    """The pages in the order in which an identification needs them."""
    order = (
        "identification data regressors settings selection partition simulation "
        "refinement confidence evaluation metrics models exporters shell linear "
        "inverse design excitation engines fleet calibration control sweep solution "
        "errors"
    ).split()
    pages = {name.page for name in names}
    missing = pages - set(order)
    if missing:
        raise ValueError(f"{sorted(missing)}: say where these pages belong")
    return [page for page in order if page in pages]


@functools.cache
def tree_of(module: str) -> ast.Module:
    """The source of a module."""
    loaded = sys.modules.get(module) or importlib.import_module(module)
    return ast.parse(inspect.getsource(loaded))


def definition(value: Any) -> ast.FunctionDef | ast.ClassDef | None:
    """How a function or class of this package is written."""
    value = inspect.unwrap(value)
    module = getattr(value, "__module__", "") or ""
    if not module.startswith("jaxnarx"):
        return None
    nodes: list[Any] = [tree_of(module)]
    for part in value.__qualname__.split("."):
        inside = [n for n in nodes[0].body if getattr(n, "name", "") == part]
        if not inside:
            return None
        nodes = inside[-1:]
    return nodes[0]


def constant(name: str, room: str) -> tuple[str, str]:
    """The type or value of a constant as written, and the words behind it."""
    module = f"jaxnarx.{room}"
    for node in tree_of(module).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            if name in [a.asname or a.name for a in node.names]:
                return constant(name, node.module.removeprefix("jaxnarx."))
    body = tree_of(module).body
    for node, behind in zip(body, [*body[1:], None], strict=True):
        targets = node.targets if isinstance(node, ast.Assign) else ()
        if isinstance(node, ast.AnnAssign):
            targets = (node.target,)
        inside = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        if name in inside:
            words = ""
            match behind:
                case ast.Expr(value=ast.Constant(value=str(text))):
                    words = text
            return ast.unparse(node), words
    return name, ""
