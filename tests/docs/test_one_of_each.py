"""One reader of a result, one class of oriented images, one strict base of tables, one skew matrix."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache

from tests.docs.rooms import modules

FILES = {"result.json", "residuals.csv", "residuals.parquet"}


@cache
def trees() -> dict[str, ast.Module]:
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in modules().items()}


def classes() -> Iterator[tuple[str, ast.ClassDef]]:
    for name, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                yield name, node


def fields(node: ast.ClassDef) -> set[str]:
    """Annotated attributes and properties."""
    annotated = {
        one.target.id
        for one in node.body
        if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)
    }
    return annotated | {one.name for one in node.body if isinstance(one, ast.FunctionDef)}


def test_the_files_of_a_result_are_named_in_its_room_only() -> None:
    """Who opens a file must name it: all others go through `photocal.results`."""
    named = {
        module
        for module, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and node.value in FILES
    }
    assert named == {"photocal.block.results.folder"}
    schema = {name for name, path in modules().items() if '"photocal.adjustment/' in path.read_text()}
    assert schema == {"photocal.block.results.folder"}


def test_one_class_of_oriented_images() -> None:
    """Images with cameras, rotations and projection centres, but for the unknowns of the adjustment."""
    places = {"station", "centre", "place", "position_m"}
    found = {
        f"{module}.{node.name}"
        for module, node in classes()
        if module.split(".")[1] != "adjustment"
        if "cameras" in fields(node) and "rotation" in fields(node) and places & fields(node)
    }
    assert found == {"photocal.geometry.oriented_images.OrientedImages"}
    named = {node.name for _, node in classes() if node.name in ("Shots", "Views", "OrientedImages")}
    assert named == {"OrientedImages"}


def test_one_strict_base_of_tables() -> None:
    bases = {
        f"{module}.{node.name}"
        for module, node in classes()
        for base in node.bases
        if isinstance(base, ast.Name) and base.id == "BaseModel"
    }
    assert bases == {"photocal.base.checked_toml.Table"}


def test_one_skew_matrix() -> None:
    """Nested lists with three zeros on the diagonal and the signs of a cross product."""
    found = [
        module
        for module, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.List)
        and len(node.elts) == 3
        and all(isinstance(row, ast.List) and len(row.elts) == 3 for row in node.elts)
        and _crosses([row.elts for row in node.elts if isinstance(row, ast.List)])
    ]
    assert found == ["photocal.geometry.rotation"]


def _crosses(rows: list[list[ast.expr]]) -> bool:
    """Whether each entry is the negative of the one across the diagonal, as it is written."""
    text = [[ast.unparse(entry) for entry in row] for row in rows]
    pairs = ((0, 1), (0, 2), (1, 2))
    return all(
        {text[i][j].removeprefix("-"), text[j][i].removeprefix("-")} == {text[j][i].removeprefix("-")}
        and text[i][j].startswith("-") != text[j][i].startswith("-")
        for i, j in pairs
    )
