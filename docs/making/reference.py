"""The reference: a page for every room with all it offers, from the source."""

import ast
import functools
import importlib
import inspect
from types import ModuleType
from typing import Any

from docstrings import markdown, prose
from names import Name, constant, definition, modules_of, public

from jaxnarx.docstrings import field_texts

TITLES = {
    "shell": "plot: figures",
    "solution": "solution: statuses",
    "errors": "errors",
    "exporters": "exporters: export",
}


def made() -> dict[str, str]:
    """The text of every page by its file name."""
    names = public()
    pages = modules_of(names)
    texts = {f"{page}.md": _page(page, names) for page in pages}
    listed = "```{toctree}\n:maxdepth: 1\n\n" + "\n".join(f"made/{p}" for p in pages)
    return texts | {"names.md": _overview(names), "_rooms.md": listed + "\n```\n"}


@functools.cache
def known() -> dict[str, str]:
    """What may stand in backticks for a public name, and its path."""
    found: dict[str, str] = {}
    for name in public():
        for path in (name.path, *name.also):
            found[path.removeprefix("jaxnarx.")] = name.path
    return found


def _overview(names: tuple[Name, ...]) -> str:
    lines = [
        "# Names for every day",
        "",
        "What `import jaxnarx as jnx` offers at its top, with a line each.",
        "",
    ]
    for page in modules_of(names):
        for name in names:
            if name.page == page and name.everyday:
                first = (inspect.getdoc(name.value) or "").split("\n\n")[0]
                first = prose(" ".join(first.split()), known())
                lines.append(f"- {{py:obj}}`~{name.path}`: {first}")
    return "\n".join(lines) + "\n"


def _page(page: str, names: tuple[Name, ...]) -> str:
    module = importlib.import_module(f"jaxnarx.{page}")
    about = markdown(inspect.getdoc(module) or "", known())
    lines = [f"# {TITLES.get(page, page)}", "", about, ""]
    here = [name for name in names if name.page == page]
    daily = [name for name in here if name.everyday]
    inside = [name for name in here if not name.everyday]
    both = bool(daily and inside)
    for title, part in (("For every day", daily), ("In this room", inside)):
        lines += [f"## {title}", ""] if both else []
        for name in part:
            lines += [_described(name), ""]
    elsewhere = [
        f"{{py:obj}}`~{name.path}`"
        for name in names
        if name.page != page
        and any(path.startswith(f"jaxnarx.{page}.") for path in name.also)
    ]
    if elsewhere:
        lines += ["Offered here too: " + ", ".join(elsewhere) + ".", ""]
    return "\n".join(lines)


def _described(name: Name) -> str:
    if isinstance(name.value, ModuleType):
        return _module(name)
    if inspect.isclass(name.value):
        return _class(name)
    node = definition(name.value) if callable(name.value) else None
    if isinstance(node, ast.FunctionDef):
        return _block("function", name.path + _signature(node), _words(name.value))
    room, _, last = name.path.removeprefix("jaxnarx.").rpartition(".")
    written, words = constant(last, room)
    shown = f"```python\n{written}\n```\n\n" if len(written) < 400 else ""
    return _block("data", name.path, shown + prose(inspect.cleandoc(words), known()))


def _module(name: Name) -> str:
    functions = [
        value
        for key, value in sorted(vars(name.value).items())
        if inspect.isfunction(value)
        and value.__module__ == name.value.__name__
        and not key.startswith("_")
    ]
    parts = [_block("module", name.path, ""), _words(name.value)]
    for value in functions:
        node = definition(value)
        if isinstance(node, ast.FunctionDef):
            path = f"{name.path}.{value.__name__}"
            parts.append(_block("function", path + _signature(node), _words(value)))
    return "\n\n".join(parts)


def _class(name: Name) -> str:
    kind, node = name.value, definition(name.value)
    body = [_words(kind)]
    texts = field_texts(kind)
    # The settings say their fields in their docstring already, see `texts.document`.
    if "\nArgs:\n" not in (inspect.getdoc(kind) or ""):
        body.append("\n".join(_field(*item) for item in _fields(kind, texts)))
    for member in node.body if isinstance(node, ast.ClassDef) else ():
        if isinstance(member, ast.FunctionDef) and _shown(member):
            body.append(_member(name.path, member))
    error = "exception" if issubclass(kind, BaseException) else "class"
    return _block(
        error, name.path + _construction(kind), "\n\n".join(b for b in body if b), 6
    )


def _fields(kind: Any, texts: dict[str, str]) -> list[tuple[str, str, str]]:
    """Public fields: name, annotation and words behind it."""
    found: dict[str, tuple[str, str, str]] = {}
    for base in reversed(kind.__mro__):
        node = definition(base) if base.__module__.startswith("jaxnarx") else None
        for line in node.body if isinstance(node, ast.ClassDef) else ():
            match line:
                case ast.AnnAssign(target=ast.Name(id=field), annotation=hint):
                    words = texts.get(field, "")
                    found[field] = (field, ast.unparse(hint).replace("'", '"'), words)
                case ast.Assign(
                    targets=[ast.Name(id=field)],
                    value=ast.Constant(value=str(words)),
                ) if kind.__name__ == "RESULTS":
                    found[field] = (field, "", words)
    return [row for field, row in found.items() if not field.startswith("_")]


def _field(field: str, hint: str, words: str) -> str:
    shown = f" `{hint}`" if hint else ""
    return f"- **{field}**{shown}" + (f": {prose(words, known())}" if words else "")


def _shown(node: ast.FunctionDef) -> bool:
    if node.name == "__call__":
        return True
    return not node.name.startswith("_") and ast.get_docstring(node) is not None


def _member(owner: str, node: ast.FunctionDef) -> str:
    marks = {ast.unparse(d) for d in node.decorator_list}
    words = markdown(ast.get_docstring(node) or "", known())
    if marks & {"property", "functools.cached_property"}:
        hint = f":type: {ast.unparse(node.returns)}\n" if node.returns else ""
        return _block("property", f"{owner}.{node.name}", hint + "\n" + words, 5)
    bound = marks & {"staticmethod", "classmethod"}
    option = f":{bound.pop()}:\n\n" if bound else ""
    return _block(
        "method", f"{owner}.{node.name}{_signature(node, True)}", option + words, 5
    )


def _signature(node: ast.FunctionDef, bound: bool = False) -> str:
    """Arguments as written, without `self`."""
    args = ast.parse(ast.unparse(node)).body[0].args  # type: ignore[attr-defined]
    every = args.posonlyargs or args.args
    if bound and every and every[0].arg in ("self", "cls"):
        every.pop(0)
    arrow = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"({ast.unparse(args)}){arrow}".replace("\n", " ")


def _construction(kind: type) -> str:
    """Names and defaults of what a class is made from."""
    if issubclass(kind, tuple | BaseException) or kind.__name__ == "RESULTS":
        return ""
    try:
        signature = inspect.signature(kind)
    except (TypeError, ValueError):
        return ""
    made = [p for n, p in signature.parameters.items() if not n.startswith("_")]
    parameters = [
        p.replace(annotation=p.empty, default=_Shown(p.default))
        if p.default is not p.empty
        else p.replace(annotation=p.empty)
        for p in made
    ]
    return str(inspect.Signature(parameters))


class _Shown:
    """A default as it is read: short values as they are, all else as an ellipsis."""

    def __init__(self, value: Any):
        text = repr(value)
        plain = isinstance(value, str | int | float | bool | tuple | type(None))
        self.text = text if plain and len(text) < 40 and "<" not in text else "..."

    def __repr__(self) -> str:
        return self.text


def _words(value: Any) -> str:
    return markdown(inspect.getdoc(value) or "", known())


def _block(kind: str, signature: str, body: str, colons: int = 4) -> str:
    fence = ":" * colons
    return f"{fence}{{py:{kind}}} {signature}\n{body.rstrip()}\n{fence}"
