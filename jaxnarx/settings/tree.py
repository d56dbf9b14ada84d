"""Settings as trees: from the tables of files, by the paths of flags and cases.

A tree is a dataclass whose fields are plain values or trees again. A tree's table is a
dictionary, with the name of the kind under `"method"` where there is a choice of kinds:
`{"grow": {"method": "tree", "max_models": 4}}`, or `{"grow": "tree"}` for its defaults.
A path names one setting, `"grow.max_models"`.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Any

from jaxnarx.errors import SpecError, suggest
from jaxnarx.settings.anova import Anova
from jaxnarx.settings.fields import field_hints, fits, union_members, words
from jaxnarx.settings.partition import Global, Grid, Lolimot, Placed, SigmoidTree
from jaxnarx.settings.pool import Polynomial
from jaxnarx.settings.protocols import SELECTORS, Selector
from jaxnarx.settings.refinement import PredictionError, SimulationError
from jaxnarx.settings.selection import Backward, ForwardOLS, StepwiseF
from jaxnarx.settings.simulation_ols import SimulationOLS

KIND_KEY = "method"
"""Key of a table that names the kind."""

METHOD_KINDS: tuple[tuple[str, type, dict[str, Any]], ...] = (
    ("polynomial", Polynomial, {}),
    ("forward", ForwardOLS, {}),
    ("stepwise", StepwiseF, {}),
    ("backward", Backward, {}),
    ("simulation", SimulationOLS, {}),
    ("anova", Anova, {}),
    ("global", Global, {}),
    ("lolimot", Lolimot, {}),
    ("tree", SigmoidTree, {}),
    ("axis-tree", SigmoidTree, {"oblique": False}),
    ("grid", Grid, {}),
    ("placed", Placed, {}),
    ("simulation", SimulationError, {}),
    ("prediction", PredictionError, {}),
)
"""Names of kinds, and what else a name says."""


def from_dict(kind: type, table: Any, where: str = "") -> Any:
    """A tree of settings from its table; `SpecError` names the path of what is wrong,
    or of what is no table.

    Where it names no kind, settings that it leaves out are the usual ones of the place.
    `where` is the path of the tree itself, for messages.
    """
    if not isinstance(table, Mapping):
        raise SpecError(
            f"{where or 'the description'} must be a table, got {table!r}", field=where
        )
    hints = field_hints(kind)
    usual = {f.name: f.default for f in dataclasses.fields(kind)}
    values = {}
    for name, value in table.items():
        if name not in hints:
            raise SpecError(
                f"{where or 'the description'} has the unknown key {name!r}. "
                f"{suggest(name, hints)}",
                field=_join(where, name),
            )
        value = _complete(value, usual[name])
        values[name] = _value(hints[name], value, _join(where, name))
    missing = [f.name for f in dataclasses.fields(kind) if _is_required(f, values)]
    if missing:
        path = _join(where, missing[0])
        raise SpecError(f"{path} is missing", field=path)
    try:
        return kind(**values)
    except SpecError as error:
        raise _with_path(error, where) from error


def to_dict(tree: Any) -> dict[str, Any]:
    """The table of a tree, all of it; values that are no settings stay as they are."""
    known = [n for n, k, told in METHOD_KINDS if k is type(tree) and _says(tree, told)]
    table: dict[str, Any] = {KIND_KEY: known[-1]} if known else {}
    for field in field_hints(type(tree)):
        value = getattr(tree, field)
        table[field] = to_dict(value) if _is_tree(value) else value
    return table


def replace_at(tree: Any, changes: Mapping[str, Any]) -> Any:
    """The tree with other values under some paths.

    A path to a choice of kinds takes the name of one, `{"grow": "tree"}`: settings that
    differ from their defaults and that it has as well go over to it.
    """
    table = to_dict(tree)
    for path, value in sorted(changes.items(), key=lambda item: item[0].count(".")):
        _put(type(tree), table, path.split("."), value, path)
    table.pop(KIND_KEY, None)
    return from_dict(type(tree), table)


def flatten_table(table: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    """A table of tables as paths and values."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        path = _join(where, name)
        inside = isinstance(value, Mapping) and len(value) > 0
        found |= flatten_table(value, path) if inside else {path: value}
    return found


def value_at(tree: Any, path: str) -> Any:
    """The setting under a path, None where the tree has another kind there; the name of
    the kind where the path leads to a tree.
    """
    for name in path.split("."):
        tree = getattr(tree, name, None)
    return to_dict(tree).get(KIND_KEY) if _is_tree(tree) else tree


def hint_at(kind: type, path: str) -> tuple[type, Any]:
    """The class that declares a path first, and what it allows there."""
    *way, last = path.split(".")
    owners: list[Any] = [kind]
    for name in way:
        inner = [
            k
            for owner in owners
            if name in field_hints(owner)
            for k in union_members(field_hints(owner)[name])
        ]
        owners = list(dict.fromkeys(k for k in inner if dataclasses.is_dataclass(k)))
    for owner in owners:
        if last in field_hints(owner):
            return owner, field_hints(owner)[last]
    known = dict.fromkeys(name for owner in owners for name in field_hints(owner))
    raise SpecError(f"there is no setting {path!r}. {suggest(last, known)}", field=last)


def kind_names(hint: Any) -> list[str]:
    """Names of the kinds that a field may hold."""
    kinds = union_members(hint)
    names = [name for name, kind, _ in METHOD_KINDS if kind in kinds]
    return names + ["none"] * (bool(names) and type(None) in kinds)


def plain_value(value: Any) -> Any:
    """A value as JSON and TOML have it: lists in place of tuples."""
    if isinstance(value, Mapping):
        return {str(key): plain_value(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain_value(item) for item in value]
    if isinstance(value, bool | str | None):
        return value
    if isinstance(value, Integral):
        return int(value)
    return float(value) if isinstance(value, Real) else value


def _complete(value: Any, usual: Any) -> Any:
    """A table that names no kind is of the usual one, if that has all its settings."""
    if not isinstance(value, Mapping) or KIND_KEY in value or not _is_tree(usual):
        return value
    known = field_hints(type(usual))
    return to_dict(usual) | dict(value) if all(k in known for k in value) else value


def _with_path(error: SpecError, where: str) -> SpecError:
    """The error with the path of the setting in place of its name."""
    text, name = str(error), error.field or ""
    if not where or not name:
        return error
    lead = f"{where}." if text.startswith(name) else f"{where}: "
    return SpecError(lead + text, field=_join(where, name))


def _join(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _is_tree(value: Any) -> bool:
    return any(type(value) is kind for _, kind, _ in METHOD_KINDS)


def _says(tree: Any, told: Mapping[str, Any]) -> bool:
    return all(getattr(tree, name) == value for name, value in told.items())


def _is_required(field: dataclasses.Field, values: Mapping[str, Any]) -> bool:
    none = field.default is field.default_factory is dataclasses.MISSING
    return none and field.init and field.name not in values


def _put(kind: type, table: dict[str, Any], way: list[str], value: Any, path: str):
    """Set one path in a table."""
    name, rest = way[0], way[1:]
    if name not in field_hints(kind):
        raise SpecError(
            f"there is no setting {path!r}. {suggest(name, field_hints(kind))}",
            field=path,
        )
    hint, old = field_hints(kind)[name], table.get(name)
    if not rest:
        choice = isinstance(value, str) and value in kind_names(hint)
        table[name] = _rename_kind(hint, old, value) if choice else value
        return
    if isinstance(old, str) or old is None:
        first = kind_names(hint)[:1]
        if not first:
            raise SpecError(f"{name} holds no settings: {path!r}", field=path)
        old = {KIND_KEY: old or first[0]}
    if not isinstance(old, Mapping):
        raise SpecError(
            f"{path} cannot be set: {name} is {type(old).__name__}", field=path
        )
    inner, _ = _kind(hint, old.get(KIND_KEY), name)
    table[name] = dict(old)
    _put(inner, table[name], rest, value, path)


def _rename_kind(hint: Any, old: Any, name: str) -> Any:
    """The table of another kind, with what both have."""
    if name == "none" or not isinstance(old, Mapping):
        return name
    kind, told = _kind(hint, name, name)
    former, _ = _kind(hint, old.get(KIND_KEY), name)
    usual = {f.name: f.default for f in dataclasses.fields(former)}
    kept = {
        field: value
        for field, value in old.items()
        if field in field_hints(kind) and field not in told and value != usual[field]
    }
    return {KIND_KEY: name} | kept


def _kind(
    hint: Any, name: str | None, where: str, keys: Sequence[str] = ()
) -> tuple[type, dict[str, Any]]:
    """The class that a name means among those of a hint; the only one needs none.

    `keys` are the settings that it must have, for the message.
    """
    kinds = union_members(hint)
    known = [(n, k, told) for n, k, told in METHOD_KINDS if k in kinds]
    if name is None and len({k for _, k, _ in known}) == 1:
        return known[0][1:]
    for n, kind, told in known:
        if n == name:
            return kind, told
    if name is None:
        every = dict.fromkeys(
            field for _, kind, _ in known for field in field_hints(kind)
        )
        for key in keys:
            if key not in every:
                raise SpecError(
                    f"{where} has the unknown key {key!r}. {suggest(key, every)}",
                    field=_join(where, key),
                )
        able = [n for n, k, _ in known if set(keys) <= set(field_hints(k))]
        raise SpecError(
            f"{where} needs a method: one of {', '.join(able or kind_names(hint))}",
            field=where,
        )
    raise SpecError(
        f"{where} must be one of {', '.join(kind_names(hint))}, got {name!r}. "
        f"{suggest(name, kind_names(hint))}",
        field=where,
    )


def _is_added(hint: Any, name: str) -> bool:
    """Whether it is a selector that another package has registered."""
    known = name in kind_names(hint) or Selector not in union_members(hint)
    return not known and name in SELECTORS


def _value(hint: Any, value: Any, path: str) -> Any:
    """A value that a field may hold, trees made from their tables."""
    if kind_names(hint):
        if isinstance(value, str) and value == "none" and "none" in kind_names(hint):
            return None
        if isinstance(value, str) and _is_added(hint, value):
            return SELECTORS[value]
        if isinstance(value, str):
            value = {KIND_KEY: value}
        if isinstance(value, Mapping):
            own = dict(value)
            kind, told = _kind(hint, own.pop(KIND_KEY, None), path, tuple(own))
            return from_dict(kind, told | own, path)
    elif (
        isinstance(value, str) and value == "none" and type(None) in union_members(hint)
    ):
        return None
    if not fits(hint, value):
        told = ", ".join(kind_names(hint))
        wanted = f"one of {told}" if told else words(hint)
        raise SpecError(f"{path} must be {wanted}, got {value!r}", field=path)
    return tuple(value) if isinstance(value, list) else value
