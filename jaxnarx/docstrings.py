"""The sentence that explains a setting, written once behind its field."""

import ast
import functools
import inspect
import sys
import textwrap


@functools.cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    """The classes of a module as they are written; none where there is no source."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (OSError, TypeError):
        return {}
    return {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}


def field_texts(settings: type) -> dict[str, str]:
    """The text behind every field of a settings class, those it inherits first."""
    found: dict[str, str] = {}
    for kind in reversed(settings.__mro__[:-1]):
        node = _classes(kind.__module__).get(kind.__name__)
        body = node.body if node else []
        for field, text in zip(body, body[1:], strict=False):
            match field, text:
                case (
                    ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(words))),
                ):
                    found[name] = " ".join(words.split())
    return found


def document_fields(settings: type) -> str:
    """The class's own words, and an `Args:` section of its fields, for `help()`."""
    node = _classes(settings.__module__).get(settings.__name__)
    # As written: what this returns may be the documentation already.
    words = ast.get_docstring(node) if node else inspect.getdoc(settings)
    lines, texts = [words or ""], field_texts(settings)
    if texts:
        lines += ["", "Args:"]
    for name, text in texts.items():
        lines.append(
            textwrap.fill(
                f"{name}: {text}",
                width=84,
                initial_indent="    ",
                subsequent_indent="        ",
            )
        )
    return "\n".join(lines)


def document(*settings: type) -> None:
    """Let `help()` tell what the fields are, for classes that a room offers."""
    for kind in settings:
        kind.__doc__ = document_fields(kind)
