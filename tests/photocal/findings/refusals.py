"""What code refuses: the sentences of its exceptions, read from the sources."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

from tests.sources import template

_PLACE = re.compile(r"\{[^{}]*\}")
# Python's own, which reach programmers; a ValueError is what pydantic and readers pass on.
_OF_PYTHON = re.compile(r"(Type|Attribute|Key|Index|Runtime|Import|OS|BlockingIO|TOMLDecode)Error$")


@dataclass(frozen=True)
class Refusal:
    """One sentence, with empty braces where values stand, and where the code has it."""

    file: str
    line: int
    text: str


def refusals_of(source: str, file: str) -> Iterator[Refusal]:
    """Find what a module refuses, and its remedies: also those that it hands to functions of its own.

    Parameters
    ----------
    source, file
        The module, and how it is named in what is found.

    Yields
    ------
    Refusal
        Those that have words: a sentence of values alone is made elsewhere.
    """
    module = _Module(ast.parse(source))
    for call, within in module.refusing():
        given = [*call.args[:2], *(key.value for key in call.keywords if key.arg in ("what", "remedy"))]
        for one in given:
            for text in module.texts(one, within):
                if re.search("[a-z]{3}", _PLACE.sub("", text)):
                    yield Refusal(file, call.lineno, " ".join(text.split()))


class _Module:
    """What names may stand for in a module."""

    def __init__(self, tree: ast.Module) -> None:
        self._tree = tree
        self._set, self._calls = dict[str, list[ast.expr]](), dict[str, list[ast.Call]]()
        self._makers = set[str]()
        for node in ast.walk(tree):
            if isinstance(node, ast.Assign):
                names = [target.id for target in node.targets if isinstance(target, ast.Name)]
                for name in names:
                    self._set.setdefault(name, []).append(node.value)
                if isinstance(node.value, ast.Call) and _last_name(node.value.func) == "at":
                    self._makers |= set(names)
            elif isinstance(node, ast.Call):
                self._calls.setdefault(_last_name(node.func), []).append(node)

    def refusing(self) -> Iterator[tuple[ast.Call, tuple[ast.FunctionDef, ...]]]:
        """Calls that make an exception, and the functions around them."""
        waiting: list[tuple[ast.AST, tuple[ast.FunctionDef, ...]]] = [(self._tree, ())]
        while waiting:
            node, within = waiting.pop()
            if isinstance(node, ast.Call):
                # `SomeError(...)`, `wrong(...)` and `SomeError.at(place)(...)`.
                made = node.func.func if isinstance(node.func, ast.Call) else node.func
                name = _last_name(made)
                if name == "at" and made is not node.func and isinstance(made, ast.Attribute):
                    name = _last_name(made.value)
                if name in self._makers or (name.endswith("Error") and not _OF_PYTHON.match(name)):
                    yield node, within
            inner = (*within, node) if isinstance(node, ast.FunctionDef) else within
            waiting += [(child, inner) for child in ast.iter_child_nodes(node)]

    def texts(self, node: ast.expr, within: tuple[ast.FunctionDef, ...]) -> list[str]:
        """Everything that an expression may read; nothing for what is made elsewhere."""
        if isinstance(node, ast.Constant):
            return [node.value] if isinstance(node.value, str) else []
        if isinstance(node, ast.JoinedStr):
            return [template(node)]
        if isinstance(node, ast.IfExp):
            return self.texts(node.body, within) + self.texts(node.orelse, within)
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            left, right = (self.texts(side, within) or ["{}"] for side in (node.left, node.right))
            return [one + other for one in left for other in right]
        if not isinstance(node, ast.Name):
            return []
        given = [one for one in self._set.get(node.id, ()) if node.id not in _names(one)]
        given += [one for function in within for one in self._handed(function, node.id)]
        return [text for one in given for text in self.texts(one, ())]

    def _handed(self, function: ast.FunctionDef, name: str) -> Iterator[ast.expr]:
        """What calls within the module give for a parameter, and its default."""
        places = [one.arg for one in (*function.args.posonlyargs, *function.args.args)]
        if name in places:
            behind = len(places) - places.index(name)
            if behind <= len(function.args.defaults):
                yield function.args.defaults[-behind]
        at = places.index(name) - (places[:1] == ["self"]) if name in places else None
        for call in self._calls.get(function.name, ()):
            if at is not None and at < len(call.args):
                yield call.args[at]
            yield from (key.value for key in call.keywords if key.arg == name)


def _last_name(node: ast.expr) -> str:
    """The name that is called: "at" of `SomeError.at`."""
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _names(node: ast.expr) -> set[str]:
    return {inner.id for inner in ast.walk(node) if isinstance(inner, ast.Name)}
