"""Every text that the program can raise, or say with a status, found in its source.

Looked at are the calls that make errors, findings, reasons, statuses and warnings, and
those of functions that pass one of their arguments on to such a call.
"""

import ast
import dataclasses
import functools
from collections.abc import Iterator
from pathlib import Path

from docstrings import markdown, prose
from names import PACKAGE, tree_of
from texts import Around, Function, Reader, bare, enclosing, split

SPEAKING = {
    "JaxnarxError": ("error", 0, "message"),
    "SpecError": ("error", 0, "message"),
    "DataError": ("error", 0, "message"),
    "DataFileError": ("error", 0, "message"),
    "ModelFileError": ("error", 0, "message"),
    "ExportError": ("error", 0, "message"),
    "Damaged": ("error", 0, "message"),
    "ValueError": ("error", 0, "message"),
    "RuntimeError": ("error", 0, "message"),
    "ImportError": ("error", 0, "message"),
    "Finding": ("finding", 2, "message"),
    "Reason": ("verdict", 1, "text"),
    "Solution": ("status", 3, "detail"),
    "replace": ("status", 99, "detail"),
    "warn": ("warning", 0, "text"),
}
"""Kind of text, place and name of the argument that holds it, by what is called."""
WORDS = ("message", "what", "otherwise", "said", "text")
"""What arguments that are passed on as texts are called, the likeliest first."""


@dataclasses.dataclass(frozen=True)
class Message:
    """A text as a template, what says it, and the file and line where it is made."""

    text: str
    says: str
    kind: str
    path: str
    line: int

    @property
    def room(self) -> str:
        """The folder or file of the package that it comes from."""
        return self.path.split("/")[0].removesuffix(".py")


@functools.cache
def found() -> tuple[Message, ...]:
    """All of them, in the order of the source."""
    files = sorted(PACKAGE.rglob("*.py"))
    return tuple(dict.fromkeys(m for path in files for m in _of_file(path)))


@functools.cache
def opened(path: Path) -> tuple[tuple[ast.AST, ...], Reader, Around]:
    """All nodes of a file, a reader of its texts, and what is around a node."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return tuple(ast.walk(tree)), Reader(tree), enclosing(tree)


def _of_file(path: Path) -> Iterator[Message]:
    nodes, reader, around = opened(path)
    where = path.relative_to(PACKAGE).as_posix()
    for node in nodes:
        match node:
            case ast.AnnAssign(target=ast.Name(id="irreversible"), value=value) if (
                value
            ):
                for text in reader.texts(value, None):
                    yield Message(text, "SpecError", "error", where, node.lineno)
        if not isinstance(node, ast.Call):
            continue
        name = called(node)
        if name in SPEAKING:
            kind, place, argument = SPEAKING[name]
            told = _argument(node, place, argument)
            frames, says = [""], name
        elif around_has(around(node), node.func):
            kind, told, says, frames = (
                "error",
                _argument(node, 0, ""),
                "DataFileError",
                [""],
            )
            argument = ""
        elif name in carriers():
            kind, says, place, argument, frames = carriers()[name]
            told = _argument(node, place, argument)
        else:
            continue
        if told is None:
            continue
        for text in reader.texts(told, around(node)):
            for frame in frames:
                whole = frame.replace(f"{{{argument}}}", text) if frame else text
                if not bare(text):
                    yield Message(whole, says, kind, where, node.lineno)


def unread() -> list[str]:
    """Where an error is raised that has no text of its own: what was caught goes on."""
    known = {(m.path, m.line) for m in found()}
    missing = []
    for path in sorted(PACKAGE.rglob("*.py")):
        where = path.relative_to(PACKAGE).as_posix()
        for node in opened(path)[0]:
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                name, line = called(node.exc), node.exc.lineno
                ours = name in SPEAKING or name in carriers()
                if ours and (where, line) not in known:
                    missing.append(f"{where}:{line}: {ast.unparse(node.exc)}")
    return missing


def called(node: ast.Call) -> str:
    """The last name of what is called."""
    match node.func:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case _:
            return ""


def _argument(node: ast.Call, place: int, name: str) -> ast.AST | None:
    for keyword in node.keywords:
        if keyword.arg == name:
            return keyword.value
    plain = not any(isinstance(a, ast.Starred) for a in node.args)
    return node.args[place] if plain and place < len(node.args) else None


@functools.cache
def carriers() -> dict[str, tuple[str, str, int, str, list[str]]]:
    """Functions that pass an argument of theirs on as a text, or as a part of one.

    By name: kind, what says it, place and name of the argument, the texts around it.
    """
    found: dict[str, tuple[str, str, int, str, list[str]]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        nodes, reader, around = opened(path)
        for node in nodes:
            name = called(node) if isinstance(node, ast.Call) else ""
            inside = around(node) if name in SPEAKING else None
            if inside is None or inside.name in SPEAKING or inside.name == "__init__":
                continue
            assert isinstance(node, ast.Call)
            kind, place, argument = SPEAKING[name]
            told = _argument(node, place, argument)
            if told is None or name == "replace":
                continue
            names = _parameters(inside)
            for own in (word for word in WORDS if word in names):
                frames = [t for t in reader.texts(told, inside) if f"{{{own}}}" in t]
                if frames:
                    place = names.index(own)
                    found[inside.name] = (kind, name, place, own, frames)
                    break
    return found


def _parameters(function: Function) -> list[str]:
    names = [a.arg for a in function.args.posonlyargs + function.args.args]
    return names[1:] if names[:1] in (["self"], ["cls"]) else names


def around_has(function: Function | None, called: ast.AST) -> bool:
    """Whether what is called is the kind of error that a function was given."""
    if function is None or not isinstance(called, ast.Name):
        return False
    return called.id == "error" and called.id in _arguments(function)


def _arguments(function: Function) -> list[str]:
    return [*_parameters(function), *(a.arg for a in function.args.kwonlyargs)]


def shown(message: Message) -> str:
    """A message as Markdown: its placeholders in italics."""
    parts = split(" ".join(message.text.split()))
    told = [
        f"*{part.strip('_') or '...'}*" if n % 2 else prose(part, {})
        for n, part in enumerate(parts)
    ]
    # Between two placeholders stands a space, or the stars would run together.
    last = len(told) - 1
    return "".join(
        text or " " * (0 < n < last) if n % 2 == 0 else text
        for n, text in enumerate(told)
    )


KINDS = {
    "status": "Details of statuses",
    "verdict": "Reasons of a verdict",
    "finding": "Findings of `check` and `invertible`",
    "warning": "Warnings of the command line",
    "error": "Errors",
}


def made() -> dict[str, str]:
    """A page of all texts by kind, and for errors by room."""
    lines = [
        "# Every message",
        "",
        "Placeholders are in *italics*. Made from the source.",
        "",
    ]
    for kind, title in KINDS.items():
        lines += [f"## {title}", ""]
        own = [m for m in found() if m.kind == kind]
        for room in dict.fromkeys(m.room for m in own):
            lines += [f"### {title}: {room}" if kind == "error" else f"**{room}**", ""]
            lines += dict.fromkeys(_line(m) for m in own if m.room == room)
            lines += [""]
    rules = ast.get_docstring(tree_of("jaxnarx.evaluation.rules")) or ""
    told = markdown(rules.partition("\n\n")[2], {})
    return {"messages.md": "\n".join(lines), "_verdict.md": told}


def _line(message: Message) -> str:
    says = f" ({message.says})" if message.kind == "error" else ""
    return f"- {shown(message)}{says}"
