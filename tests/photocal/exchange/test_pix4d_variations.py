"""A `params` folder as copies, spreadsheets and other systems leave it: read the same, or refused by name."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import PhotocalError
from photocal.block.model import ROLES, Block
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.formats import read_foreign_project
from photocal.geometry.camera import camera
from tests.photocal.exchange.conftest import of_role, reconstruction_of, roles_of
from tests.photocal.exchange.pix4d_folder import write_params

AT = np.array([677000.0, 7184000.0, 900.0])
EXTERNAL = "*calibrated_external_camera_parameters.txt"
Change = Callable[[Path], None]


@pytest.fixture(scope="module")
def own() -> Block:
    """One camera, in map coordinates; a tie point has the number of a control point."""
    lens = camera("0", "brown-ideal", "mm", (4608, 3456), (0.005, 0.005), {"c": 20.0, "K1": -1e-5})
    made = reconstruction_of((lens,))
    poses = made.images.values + np.concatenate([np.zeros(3), AT])
    seen = np.flatnonzero(np.bincount(made.observations.point, minlength=len(made.points.values)) > 1)
    names, control = list(made.points.names), of_role(made, "control")
    tie = next(k for k in of_role(made, "tie")[::-1] if k in seen)
    names[tie] = names[control[0]]
    points = replace(made.points, names=tuple(names), values=made.points.values + AT)
    return replace(made, images=replace(made.images, values=poses), points=points)


def read(folder: Path, own: Block, change: Change = lambda _: None) -> ForeignProject:
    """Write the folder, change it, read it."""
    write_params(folder, own, manual=(int(of_role(own, "tie")[0]),), offset=AT)
    change(folder)
    return read_foreign_project(folder)


def within(pattern: str, how: Callable[[bytes], bytes]) -> Change:
    """Change what stands in some files."""

    def change(folder: Path) -> None:
        for path in folder.glob(pattern):
            path.write_bytes(how(path.read_bytes()))

    return change


def underscores(text: bytes) -> bytes:
    """Digits set apart by underscores, which are no decimal numbers to a surveyor."""
    return re.sub(rb"(\d)\.(\d)", rb"\1_0.\2", text)


def gone(*patterns: str) -> Change:
    """Delete some files."""

    def change(folder: Path) -> None:
        for path in [path for pattern in patterns for path in folder.glob(pattern)]:
            path.unlink()

    return change


def capitals(folder: Path) -> None:
    for path in list(folder.iterdir()):
        path.rename(path.with_suffix(path.suffix.upper()))


def bare(folder: Path) -> None:
    for path in list(folder.iterdir()):
        path.rename(folder / path.name.removeprefix("field 3_"))


def commas(content: bytes) -> bytes:
    return re.sub(rb"(\d)\.(\d)", rb"\1,\2", content)


def of_a_spreadsheet(content: bytes) -> bytes:
    return commas(content.replace(b", ", b";"))


SAME = {
    "CRLF": within("*", lambda content: content.replace(b"\n", b"\r\n")),
    "CR": within("*", lambda content: content.replace(b"\n", b"\r")),
    "BOM": within("*", lambda content: b"\xef\xbb\xbf" + content),
    "UTF-16": within("*", lambda content: content.decode().encode("utf-16")),
    "no blank after commas": within("*", lambda content: content.replace(b", ", b",")),
    "capitals": capitals,
    "no name of a project": bare,
    "offset with commas": within("*offset.xyz", lambda content: content.strip().replace(b" ", b", ")),
    "no offset": gone("*offset.xyz"),
    "nothing that is not needed": gone("*.cam", "*pmatrix*", "*images_position*", "*_measured_gcps*"),
    "errors of a spreadsheet": within("*error.txt", of_a_spreadsheet),
    "control of a spreadsheet": within("*measured_estimated*", of_a_spreadsheet),
}


@pytest.mark.parametrize("change", SAME.values(), ids=SAME.keys())
def test_variations_are_read_the_same(
    tmp_path_factory: pytest.TempPathFactory, own: Block, change: Change
) -> None:
    expected = read(tmp_path_factory.mktemp("plain"), own)
    given = read(tmp_path_factory.mktemp("changed"), own, change)
    assert given.block.images.names == expected.block.images.names
    assert given.block.points.names == expected.block.points.names
    np.testing.assert_allclose(given.block.images.values, expected.block.images.values, atol=1e-6)
    np.testing.assert_array_equal(given.block.points.values, expected.block.points.values)
    np.testing.assert_array_equal(given.block.observations.values, expected.block.observations.values)
    np.testing.assert_array_equal(given.position, expected.position)


def test_a_tie_point_with_the_number_of_a_control_point_is_another(tmp_path: Path, own: Block) -> None:
    block = read(tmp_path, own).block
    control = own.points.names[of_role(own, "control")[0]]
    (at,) = (k for k, name in enumerate(block.points.names) if name == control)
    assert ROLES[block.points.role[at]] == "control"
    rays = np.bincount(own.observations.point, minlength=len(own.points.values))
    (there,) = (
        k for k, name in enumerate(own.points.names) if name == control and roles_of(own)[k] == "control"
    )
    assert np.count_nonzero(block.observations.point == at) == rays[there]
    assert f"tie {control}" in block.points.names


REFUSED = {
    "cameras": (within("*calibrated_camera_parameters.txt", commas), "decimal comma"),
    "offset": (within("*offset.xyz", commas), "decimal comma"),
    "rays": (within("*tp_bingo.txt", commas), "decimal comma"),
    "rays with underscores": (within("*tp_bingo.txt", underscores), "no coordinates"),
    "errors": (within("*error.txt", commas), "decimal point"),
    "control": (within("*measured_estimated*", commas), "decimal point"),
    "nothing tells the offset": (gone("*offset.xyz", EXTERNAL), "no ..._offset.xyz"),
    "no rays": (gone("*tp_bingo.txt"), "no ..._tp_bingo.txt; export it"),
}


@pytest.mark.parametrize(("change", "said"), REFUSED.values(), ids=REFUSED.keys())
def test_what_cannot_be_read_is_named(tmp_path: Path, own: Block, change: Change, said: str) -> None:
    with pytest.raises(PhotocalError, match=re.escape(said)):
        read(tmp_path, own, change)
