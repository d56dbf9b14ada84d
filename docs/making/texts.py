"""What a text in the source can come to: constants, f-strings, branches, variables."""

import ast
import itertools
from collections.abc import Callable, Iterable, Sequence

MOST = 16
"""Alternatives of one text that are followed; beyond, a part stays a placeholder."""
ASSIGNMENT = ast.Assign | ast.AnnAssign | ast.AugAssign | ast.NamedExpr
Function = ast.FunctionDef | ast.AsyncFunctionDef
Around = Callable[[ast.AST], Function | None]


class Reader:
    """Reads texts of one module.

    A text is a template: what is known only when the program runs stands in braces.
    """

    def __init__(self, tree: ast.Module):
        self.tree = tree
        self.parents = {
            id(child): (node, name)
            for node in ast.walk(tree)
            for name, value in ast.iter_fields(node)
            for child in (value if isinstance(value, list) else [value])
            if isinstance(child, ast.AST)
        }
        self.constants = {
            target.id: node.value
            for node in tree.body
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        self.functions = {
            node.name: node for node in ast.walk(tree) if isinstance(node, Function)
        }

    def texts(
        self, node: ast.AST | None, inside: Function | None, depth: int = 0
    ) -> list[str]:
        """Every template that an expression can come to, in the function around it."""

        def each(part: ast.AST | None) -> list[str]:
            return self.texts(part, inside, depth + 1)

        found: list[str]
        match node:
            case _ if depth > 8:
                found = []
            case ast.Constant(value=str(text)):
                return [text.replace("{", "{{").replace("}", "}}")]
            case ast.JoinedStr(values=parts):
                found = _joined(each(part) for part in parts)
            case ast.FormattedValue(value=value, format_spec=None, conversion=-1):
                found = each(value)
            case ast.BinOp(op=ast.Add(), left=left, right=right):
                found = _joined([each(left), each(right)])
            case ast.BinOp(op=ast.Mult(), left=ast.Constant(value=str()) as left):
                found = ["", *each(left)]
            case ast.IfExp(body=body, orelse=orelse):
                found = each(body) + each(orelse)
            case ast.BoolOp(values=values):
                found = [text for value in values for text in each(value)]
            case ast.Call(func=ast.Attribute(attr="strip" | "rstrip", value=value)):
                found = each(value)
            case ast.Call(func=ast.Name(id=name)) if name in self.functions:
                found = self._returned(self.functions[name], depth + 1)
            case ast.Name() if inside is not None:
                found = self._variable(node, inside, depth + 1)
            case _:
                found = []
        found = list(dict.fromkeys(found))
        return found if 0 < len(found) <= MOST else [_placeholder(node)]

    def _variable(self, node: ast.Name, inside: Function, depth: int) -> list[str]:
        """What a variable can hold where it is read, or a constant of the module.

        Of assignments in the text above, one in a block around the place counts alone,
        one in a branch beside it as a possibility.
        """
        held: list[str] = []
        base: list[str] = []
        rest: list[str] = []
        begun: list[str] = []
        branch: list[tuple[int, str]] = []
        around = self._blocks(node)
        for line in sorted(
            (n for n in ast.walk(inside) if isinstance(n, ASSIGNMENT)),
            key=lambda n: (n.lineno, n.col_offset),
        ):
            target = line.targets[0] if isinstance(line, ast.Assign) else line.target
            named = isinstance(target, ast.Name) and target.id == node.id
            if not named or line.lineno >= node.lineno or line.value is None:
                continue
            told, blocks = self.texts(line.value, inside, depth), self._blocks(line)
            adds = isinstance(line, ast.AugAssign)
            if blocks[0] in around:  # in every case
                held = _joined([held, told]) if adds else told
                continue
            if blocks[:1] == branch[:1] and adds:  # what goes on in a branch
                begun = _joined([begun, told])
                held = [*rest, *begun]
                continue
            if not _exclusive(blocks, branch):
                rest = base = held
            begun = _joined([base, told]) if adds else told
            branch, rest = blocks, held
            held = [*rest, *begun]
        if not held and node.id in self.constants:
            held = self.texts(self.constants[node.id], None, depth)
        return held

    def _blocks(self, node: ast.AST) -> list[tuple[int, str]]:
        """The blocks of statements around a node, the innermost first."""
        found = []
        while id(node) in self.parents:
            node, name = self.parents[id(node)]
            if name in ("body", "orelse", "finalbody", "handlers"):
                found.append((id(node), name))
        return found

    def _returned(self, function: Function, depth: int) -> list[str]:
        """The texts that a function of this module returns, if it returns any."""
        found: list[str] = []
        for node in ast.walk(function):
            if isinstance(node, ast.Return) and node.value is not None:
                found += self.texts(node.value, function, depth)
        return [] if all(bare(text) for text in found) else found


def _exclusive(first: list[tuple[int, str]], second: list[tuple[int, str]]) -> bool:
    """Whether two places lie in different branches of one statement."""
    return any(a == b and x != y for a, x in first for b, y in second)


def bare(text: str) -> bool:
    """Whether a template says nothing by itself."""
    outside = "".join(part for n, part in enumerate(split(text)) if n % 2 == 0)
    return not any(c.isalpha() for c in outside)


def split(template: str) -> list[str]:
    """Words and placeholders of a template in turn; doubled braces are braces."""
    parts, depth, n = [""], 0, 0
    while n < len(template):
        two = template[n : n + 2]
        if depth == 0 and two in ("{{", "}}"):
            parts[-1] += two[0]
            n += 2
            continue
        if template[n] == "{":
            depth += 1
        if depth == 1 and template[n] in "{}":
            parts.append("")
        else:
            parts[-1] += template[n]
        if template[n] == "}":
            depth -= 1
        n += 1
    return parts


def _joined(parts: Iterable[list[str]]) -> list[str]:
    chosen: list[Sequence[str]] = []
    count = 1
    for part in parts:
        count *= max(len(part), 1)
        chosen.append(part if count <= MOST else ["{...}"])
        count = min(count, MOST)
    return ["".join(combination) for combination in itertools.product(*chosen)]


def _placeholder(node: ast.AST | None) -> str:
    match node:
        case ast.FormattedValue(value=value):
            return _placeholder(value)
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return f"{{{name.strip('_')}}}"
        case ast.Subscript(value=value):
            return _placeholder(value)
        case ast.Call(func=ast.Name(id=name), args=[first, *_]) if name in (
            *("str", "repr", "len", "min", "max", "sorted", "round"),
            *("type", "abs", "int", "float", "list"),
        ):
            return _placeholder(first)
        case ast.Call(func=ast.Attribute(attr="join"), args=[first, *_]):
            return _placeholder(first)
        case ast.Call(func=ast.Attribute(value=value)):
            return _placeholder(value)
        case ast.Call(func=func):
            return _placeholder(func)
        case ast.ListComp(elt=inner) | ast.GeneratorExp(elt=inner):
            return _placeholder(inner)
        case ast.Starred(value=inner):
            return _placeholder(inner)
        case _:
            return "{...}"


def enclosing(tree: ast.Module) -> Around:
    """A function that tells the innermost function around a node."""
    owner: dict[int, Function | None] = {}

    def visit(node: ast.AST, inside: Function | None) -> None:
        owner[id(node)] = inside
        for child in ast.iter_child_nodes(node):
            visit(child, node if isinstance(node, Function) else inside)

    visit(tree, None)
    return lambda node: owner[id(node)]
