"""Options of commands that are settings of the identification, made from its tree."""

import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from tyro.conf import arg

from jaxnarx.docstrings import field_texts
from jaxnarx.errors import DataFileError, SpecError
from jaxnarx.settings import (
    KIND_KEY,
    METHOD_KINDS,
    Global,
    Identification,
    field_hints,
    flatten_table,
    from_dict,
    hint_at,
    kind_names,
    plain_value,
    replace_at,
    to_dict,
    union_members,
    value_at,
)
from jaxnarx.shell.commands import Identify, Invert
from jaxnarx.shell.commands.search import Automatic
from jaxnarx.shell.commands.search_flags import (
    make_search,
    refuse_search,
    search_options,
    words_of_search,
)

SETTING_PATHS = {
    "output": "pool.outputs",
    "input_lags": "pool.input_lags",
    "output_lags": "pool.output_lags",
    "filters": "pool.filters",
    "degree": "pool.degree",
    "terms": "select.max_terms",
    "select": "select",
    "significance": "select.significance",
    "constant": "select.constant",
    "models": "grow.max_models",
    "schedule": "grow.scheduling",
    "partition": "grow",
    "local_terms": "grow.local.max_terms",
    "criterion": "grow.criterion",
    "feedback": "grow.feedback",
    "k_sigma": "grow.k_sigma",
    "horizons": "refine.horizons",
    "steps": "refine.max_steps",
    "window_steps": "refine.window_steps",
    "train": "refine.train",
    "ridge": "refine.ridge",
    "loss": "refine.loss",
    "log": "refine.box_cox",
    "starts": "refine.starts",
}
"""Options with a name of their own, and the settings they are."""
ARGUMENT_OPTIONS = {"over": "map", "beside": "compare"}
"""Arguments of verbs that errors name, and the options they are."""
OUTPUT_PATH = SETTING_PATHS["output"]
"""The one setting of a method that a search has as well."""
COMMAND_OPTIONS: dict[type, dict[str, str]] = {
    Identify: SETTING_PATHS,
    Invert: {
        name: SETTING_PATHS[name]
        for name in (
            *("input_lags", "output_lags", "degree", "terms"),
            *("models", "schedule", "partition"),
        )
    }
    | {"direct_steps": "refine.max_steps"},
}
DEFAULT_PARTITION = {Identify: "lolimot", Invert: "axis-tree"}
"""How the operating space is divided where only the number of models is told."""
METAVARS = {
    "output": "NAME [NAME ...]",
    "schedule": "NAME [NAME ...]",
    "log": "NAME [NAME ...]",
    "filters": "SECONDS [SECONDS ...]",
    "input_lags": "[LAG ...]",
    "output_lags": "[LAG ...]",
    "horizons": "INT [INT ...]",
}
OPTION_HELP = {
    "log": "Outputs whose error is refined on a logarithmic scale, such as HC or "
    "particle number; they must be positive.",
    "local_terms": "Every region keeps this many of the chosen terms, chosen anew by "
    "error reduction ratio; without it all of them.",
    "steps": "Refinement steps on full records; 0 keeps the one-step model.",
    "direct_steps": "Refinement steps of the inverse by itself, on its free run; 0 for "
    "none.",
}
"""What an option says that its setting does not."""


def add_options(command: type) -> type:
    """The command's class for the parser: options in place of its `method`."""
    if command not in COMMAND_OPTIONS:
        return command
    texts = field_texts(command)
    hints = get_type_hints(command, include_extras=True)
    made: list[Any] = []
    for field in dataclasses.fields(command):
        if field.name != "method":
            hint = _annotate(hints[field.name], texts[field.name])
            usual = field.default
            made.append(
                (field.name, hint)
                if usual is dataclasses.MISSING
                else (field.name, hint, dataclasses.field(default=usual))
            )
            continue
        base = _base(command)
        for name, path in COMMAND_OPTIONS[command].items():
            made.append((name, _option(command, name, path, base), None))
            if name == "output":
                made += search_options()
        made.append(("set", _annotate(tuple[str, ...], SET_HELP, _SET_ARGUMENT), ()))
        made.append(
            ("settings", _annotate(str | None, SETTINGS_HELP, _SETTINGS_ARGUMENT), None)
        )
    return dataclasses.make_dataclass(command.__name__, made, frozen=True)


SET_HELP = """Any other setting of `jaxnarx.Identification` by its path, such as
refine.tolerance=1e-5."""
SETTINGS_HELP = """TOML file of settings in sections [pool], [select], [grow] and
[refine], which the other options change."""
_SET_ARGUMENT = arg(metavar="PATH=VALUE [...]", help_behavior_hint="")
_SETTINGS_ARGUMENT = arg(metavar="FILE", help_behavior_hint="")


def settle_command(command: type, parsed: Any) -> Any:
    """The command with its `method`, from what was parsed."""
    if command not in COMMAND_OPTIONS:
        return parsed
    own = {f.name: f for f in dataclasses.fields(command)}
    method = _base(command)
    if parsed.settings is not None:
        method = _read_settings(Path(parsed.settings))
    changes = {
        path: value
        for name, path in COMMAND_OPTIONS[command].items()
        if (value := getattr(parsed, name)) is not None
    }
    changes |= dict(_parse_assignment(text) for text in parsed.set)
    kept = {name: getattr(parsed, name) for name in own if name != "method"}
    if command is Identify:
        told = ["settings"] if parsed.settings is not None else []
        told += [_option_at(command, path) for path in changes if path != OUTPUT_PATH]
        if not told:
            return command(**kept, method=make_search(parsed))
        refuse_search(parsed, told[0])
    return command(**kept, method=_change_method(command, method, changes))


def _base(command: type) -> Identification:
    """The settings that options change."""
    usual = next(f.default for f in dataclasses.fields(command) if f.name == "method")
    return usual if isinstance(usual, Identification) else Identification()


def _change_method(
    command: type, method: Identification, changes: dict[str, Any]
) -> Identification:
    """The method under the options, checked as far as can be without data."""
    steps = (
        COMMAND_OPTIONS[command].get("steps")
        or COMMAND_OPTIONS[command]["direct_steps"]
    )
    if changes.get(steps) == 0:
        changes = {k: v for k, v in changes.items() if not k.startswith("refine")}
        changes["refine"] = "none"
    if "refine.box_cox" in changes and isinstance(changes["refine.box_cox"], tuple):
        changes["refine.box_cox"] = dict.fromkeys(changes["refine.box_cox"], 0.0)
    inside = [path for path in changes if path.startswith("grow.")]
    if isinstance(method.grow, Global) and changes.get("grow", "global") == "global":
        if changes.get("grow.max_models") == 1 and len(inside) == 1:
            del changes["grow.max_models"]
        elif inside:
            changes["grow"] = DEFAULT_PARTITION[command]
    models = changes.get("grow.max_models", 1)
    if models < 1:
        raise SpecError(
            f"max_models must be at least 1, got {models}", field="max_models"
        )
    divides = changes.get("grow", "global") != "global"
    scheduled = getattr(method.grow, "scheduling", ())
    if divides and not changes.get("grow.scheduling", scheduled):
        told = [f"--{_option_at(command, path)}" for path in (*inside, "grow")]
        raise SpecError(
            f"{told[0]} needs --schedule, the variables that divide the operating "
            "space, such as --schedule 'speed[t]'"
        )
    for path in changes:
        _require_place(command, method, changes, path)
    return replace_at(method, changes)


def _require_place(
    command: type, method: Identification, changes: Mapping[str, Any], path: str
) -> None:
    """SpecError where an option belongs to another kind than the one that is chosen."""
    section, _, name = path.partition(".")
    kind = changes.get(section) or to_dict(getattr(method, section)).get(KIND_KEY)
    known = union_members(field_hints(Identification)[section])
    chosen = [k for n, k, _ in METHOD_KINDS if n == kind and k in known]
    if name and chosen and name.partition(".")[0] not in field_hints(chosen[0]):
        raise SpecError(
            f"--{_option_at(command, path)} does not go with "
            f"--{_option_at(command, section)} {kind}",
            field=name,
        )


def flag_of(field: str) -> str:
    """A setting, by its path or its last name, or an argument, as it is typed."""
    for name, path in SETTING_PATHS.items():
        if field in (path, path.rpartition(".")[2]):
            return "--" + name.replace("_", "-")
    name = ARGUMENT_OPTIONS.get(field, field).replace("_", "-")
    return f"--set {field}" if "." in field else f"--{name}"


def _option_at(command: type, path: str) -> str:
    for name, own in COMMAND_OPTIONS[command].items():
        if own == path:
            return name.replace("_", "-")
    return f"set {path}"


def words_of(command: Identify) -> list[str]:
    """The command as it is typed: its description, and what differs from defaults."""
    words = ["jaxnarx", "identify", command.description]
    if isinstance(command.method, Automatic):
        words += words_of_search(command.method)
    else:
        words += _words_of_method(command.method)
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        if field.name in ("description", "method") or value == field.default:
            continue
        words.append("--" + field.name.replace("_", "-"))
        if not isinstance(value, bool):
            words.append(_text(value))
    return words


def _words_of_method(method: Identification) -> list[str]:
    """The options of a method that differ from defaults."""
    tree, values = to_dict(method), dict[str, Any]()
    kinds = {s: tree[s][KIND_KEY] for s in ("select", "grow", "refine") if tree[s]}
    if kinds["grow"] != "global":
        values["grow.scheduling"] = value_at(method, "grow.scheduling")
    base = replace_at(Identification(), kinds | values)
    if kinds["select"] != "forward":
        values["select"] = kinds["select"]
    if kinds["grow"] not in ("global", DEFAULT_PARTITION[Identify]):
        values["grow"] = kinds["grow"]
    if method.refine is None:
        values["refine.max_steps"] = 0
    elif kinds["refine"] != "simulation":
        values["refine"] = kinds["refine"]
    for path in flatten_table(tree):
        path = "refine.box_cox" if path.startswith("refine.box_cox.") else path
        value = value_at(method, path)
        kind = path == "refine" or path.endswith(f".{KIND_KEY}")
        if not kind and value != value_at(base, path):
            values[path] = tuple(value) if isinstance(value, Mapping) else value
    options = {
        path: "--" + name.replace("_", "-") for name, path in SETTING_PATHS.items()
    }
    words, others = [], []
    for path, value in values.items():
        if path in options:
            several = value if isinstance(value, tuple) else (value,)
            words += [options[path], *map(_text, several)]
        else:
            others.append(f"{path}={_toml(value)}")
    return words + (["--set", *others] if others else [])


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _toml(value: Any) -> str:
    """A plain value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(value) if isinstance(value, str) else str(value)


def _parse_assignment(text: str) -> tuple[str, Any]:
    """`refine.tolerance=1e-5` as a path and a value."""
    path, sign, value = text.partition("=")
    if not sign:
        raise SpecError(f"--set takes PATH=VALUE, got {text!r}", field="set")
    hint_at(Identification, path)
    try:
        return path, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return path, value


def _read_settings(path: Path) -> Identification:
    """The settings of a file."""
    from jaxnarx.data import load_toml

    try:
        return from_dict(Identification, load_toml(path))
    except SpecError as error:
        raise DataFileError(f"{path}: {error}", path=path) from error


def _option(command: type, name: str, path: str, base: Identification) -> Any:
    """The annotated type of one option, with its help."""
    owner, hint = hint_at(Identification, path)
    last = path.rpartition(".")[2]
    words = OPTION_HELP.get(name) or field_texts(owner)[last].partition(" In Python")[0]
    conf = arg(
        metavar=METAVARS.get(name),
        help=" ".join(words.split()),
        help_behavior_hint=_default_text(command, name, path, base),
    )
    return Annotated[_type(name, hint) | None, conf]


def _default_text(command: type, name: str, path: str, base: Identification) -> str:
    """The help's words on the default."""
    owner, _ = hint_at(Identification, path)
    if name == "models":
        return f"(default: 1, with --schedule {owner.max_models})"
    if name == "partition":
        return f"(default: global, with --schedule {DEFAULT_PARTITION[command]})"
    if name in ("log", "local_terms"):
        return ""
    usual = plain_value(value_at(base, path))
    if usual is None:
        usual = plain_value(getattr(owner, path.rpartition(".")[2], None))
    if usual is None or usual == []:
        return ""
    shown = " ".join(map(str, usual)) if isinstance(usual, list) else usual
    return f"(default: {'1/3' if shown == 1 / 3 else shown})"


def _type(name: str, hint: Any) -> Any:
    """The kind of value that is typed."""
    if kind_names(hint):
        return Literal[tuple(dict.fromkeys(kind_names(hint)))]
    if name == "log":
        return tuple[str, ...]
    if name == "filters":
        return tuple[float, ...]
    for kind in (part for part in union_members(hint) if part is not type(None)):
        if (
            get_origin(kind) is Literal
            or kind is int
            and float not in union_members(hint)
        ):
            return kind
        if get_origin(kind) is Sequence:
            return tuple[get_args(kind)[0], ...]
    return float


def _annotate(hint: Any, text: str, conf: Any = None) -> Any:
    """An annotation that carries its own help."""
    kind, *told = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    text = " ".join(text.split())
    known: Any = conf or next(
        (c for c in told if hasattr(c, "help_behavior_hint")), arg()
    )
    rest = [c for c in told if c is not known]
    return Annotated[(kind, *rest, dataclasses.replace(known, help=text))]
