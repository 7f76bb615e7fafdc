"""BAL: problems read back to the last digit, damaged ones refused, minimum and covariance from elsewhere."""

from __future__ import annotations

import bz2
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from photocal.adjustment import layout
from photocal.adjustment.adjust import adjust
from photocal.adjustment.adjusted import fit
from photocal.adjustment.condensed import condensed
from photocal.adjustment.network import Network
from photocal.adjustment.solution import Solution
from photocal.analysis.georeferencing.direct import calibration_of
from photocal.base.errors import InputMalformedError
from photocal.block.network import assemble
from photocal.commands.cli import app
from photocal.exchange import bal
from photocal.exchange.formats import read_any_block, read_foreign_project
from photocal.geometry.camera import PARAMETERS
from tests.benchmarks import bal as bench
from tests.benchmarks import make_bal

Floats = NDArray[np.float64]
SMALL = make_bal.Shape(9, 90, 420, "street")
# So long that a border of its cameras takes more work than a band.
LONG = make_bal.Shape(30, 400, 1700, "street")
TEXT = (
    "2 2 4\n0 0 -3.5 1.5\n0 1 2.5 -4.5\n1 0 -5.5 0.5\n1 1 6.5 7.5\n"
    + "0.5\n-0.25\n0.125\n1.5\n2.5\n-9.5\n600.5\n-0.5\n0.25\n" * 2
    + "0.5\n1.5\n2.5\n" * 2
)
OF_LENS = [PARAMETERS.index(name) for name in ("c", "K1", "K2")]


def seen(cameras: Floats, points: Floats, problem: bal.BalProblem) -> Floats:
    """Image points as BAL's page writes them down, one ray after the other."""
    result = np.empty_like(problem.plane)
    for r, (i, j) in enumerate(zip(problem.image, problem.point, strict=True)):
        turn, shift, (f, k1, k2) = cameras[i, :3], cameras[i, 3:6], cameras[i, 6:]
        p = Rotation.from_rotvec(turn).apply(points[j]) + shift
        p = -p[:2] / p[2]
        square = float(p @ p)
        result[r] = f * (1 + k1 * square + k2 * square**2) * p
    return result


@pytest.fixture(scope="module")
def problem() -> bal.BalProblem:
    return make_bal.make(SMALL, seed=3)


@pytest.fixture(scope="module")
def solution(problem: bal.BalProblem) -> Solution:
    return adjust(bench.network_of(problem, one_camera=False))


@pytest.mark.parametrize("name", ["problem.txt", "problem-9-90-pre.txt.bz2", "problem.txt.gz"])
def test_what_is_written_is_read_back(tmp_path: Path, problem: bal.BalProblem, name: str) -> None:
    make_bal.write(problem, tmp_path / name)
    for before, after in zip(problem, bal.read_problem(tmp_path / name), strict=True):
        np.testing.assert_array_equal(before, after)
    block = read_any_block(tmp_path / name)
    assert (len(block.cameras), len(block.points.names), block.datum) == (9, 90, "free")
    assert block.inputs[0].path == name


def test_made_problems_have_the_sizes_of_their_shapes(problem: bal.BalProblem) -> None:
    again, other = make_bal.make(SMALL, seed=3), make_bal.make(SMALL, seed=4)
    np.testing.assert_array_equal(problem.plane, again.plane)
    assert not np.array_equal(problem.points, other.points)
    for kind in make_bal.KINDS:
        shape = make_bal.Shape(40, 600, 2500, kind)
        made = make_bal.make(shape)
        assert (len(made.cameras), len(made.points), len(made.image)) == shape[:3]
        assert np.bincount(made.point).min() >= 2
        # No point twice in an image, and as many pixels off at the start as in the files of BAL.
        assert len(np.unique(made.point * 40 + made.image)) == len(made.image)
        off = make_bal.project(made.cameras, made.points, made.image, made.point) - made.plane
        assert 1.0 < np.median(np.abs(off)) < 10.0


def test_the_projection_is_that_of_the_format(problem: bal.BalProblem) -> None:
    network = assemble(bal.block_of(problem, "bal")).network
    rays = network.rays
    q = network.points.values[rays.point] - network.exposures.values[rays.image, 3:]
    # The first image, by its own lens, from the public face of lenses.
    from photocal.geometry.distortion import projected
    from photocal.geometry.rotation import matrix_from_angles

    turn = matrix_from_angles(network.exposures.values[:, :3])[rays.image]
    q = np.einsum("nij,nj->ni", turn, q)
    first = rays.image == 0
    expected = seen(problem.cameras, problem.points, problem)[problem.image == 0]
    np.testing.assert_allclose(projected(network.cameras[0], q[first]), expected, rtol=1e-9, atol=1e-7)


def test_the_minimum_is_that_of_an_independent_solver(problem: bal.BalProblem, solution: Solution) -> None:
    count = problem.cameras.size

    def residuals(x: Floats) -> Floats:
        return (
            make_bal.project(x[:count].reshape(-1, 9), x[count:].reshape(-1, 3), problem.image, problem.point)
            - problem.plane
        ).ravel()

    np.testing.assert_allclose(
        make_bal.project(problem.cameras, problem.points, problem.image, problem.point),
        seen(problem.cameras, problem.points, problem),
        rtol=1e-10,
    )
    start = np.concatenate([problem.cameras.ravel(), problem.points.ravel()])
    theirs = least_squares(residuals, start, method="lm", x_scale="jac", ftol=1e-14, xtol=1e-14)
    assert solution.chi_squared == pytest.approx(2 * theirs.cost, rel=1e-8)
    lenses = theirs.x[:count].reshape(-1, 9)[:, 6:]
    sigma = np.sqrt(np.diagonal(solution.camera_covariance, axis1=1, axis2=2))[:, OF_LENS]
    # Parameters of lenses do not depend on the datum.
    assert np.abs((solution.cameras[:, OF_LENS] - lenses) / sigma).max() < 1e-3
    assert solution.chi_squared < problem.plane.size


def test_the_covariance_is_the_dense_inverse_with_seven_constraints(
    problem: bal.BalProblem, solution: Solution
) -> None:
    images, points = SMALL.images, SMALL.points
    turn, centre = solution.state.rotation, solution.state.centre
    lens = solution.cameras[:, OF_LENS]

    def computed(x: Floats) -> Floats:
        of_image, moved = x[: 9 * images].reshape(-1, 9), x[9 * images :].reshape(-1, 3)
        matrix = Rotation.from_rotvec(of_image[:, :3]).as_matrix() @ turn
        shift = -np.einsum("nij,nj->ni", matrix, centre + of_image[:, 3:6])
        cameras = np.hstack([Rotation.from_matrix(matrix).as_rotvec(), shift, lens + of_image[:, 6:]])
        return make_bal.project(cameras, solution.points + moved, problem.image, problem.point).ravel()

    size = 9 * images + 3 * points
    step = np.concatenate(
        [np.tile([1e-6] * 3 + [1e-5] * 3 + [1e-3, 1e-6, 1e-6], images), np.full(3 * points, 1e-5)]
    )
    design = np.empty((problem.plane.size, size))
    for k in range(size):
        ahead = np.zeros(size)
        ahead[k] = step[k]
        design[:, k] = (computed(ahead) - computed(-ahead)) / (2 * step[k])
    scale = np.linalg.norm(design, axis=0)
    # The seven moves that no ray sees; inner constraints are over the points.
    moves = np.zeros((size, 7))
    of_points = moves[9 * images :].reshape(points, 3, 7)
    of_points[:, :, :3] = np.eye(3)
    for axis in range(3):
        of_points[:, :, 3 + axis] = np.cross(np.eye(3)[axis], solution.points)
    of_points[:, :, 6] = solution.points
    bordered = np.zeros((size + 7, size + 7))
    bordered[:size, :size] = (design / scale).T @ (design / scale)
    constraint = moves / scale[:, None]
    constraint /= np.linalg.norm(constraint, axis=0)
    bordered[:size, size:], bordered[size:, :size] = constraint, constraint.T
    covariance = np.linalg.inv(bordered)[:size, :size] / np.outer(scale, scale)
    for k in range(points):
        own = 9 * images + 3 * k + np.arange(3)
        expected = covariance[np.ix_(own, own)]
        off = solution.point_covariance[k] - expected
        assert np.abs(off).max() < 1e-4 * np.trace(expected)
    for k in range(images):
        own = 9 * k + 6 + np.arange(3)
        expected = covariance[np.ix_(own, own)]
        root = np.sqrt(np.diag(expected))
        off = solution.camera_covariance[k][np.ix_(OF_LENS, OF_LENS)] - expected
        assert np.abs(off / np.outer(root, root)).max() < 1e-4
        own = 9 * k + 3 + np.arange(3)
        expected = covariance[np.ix_(own, own)]
        assert np.abs(solution.exposure_covariance[k][3:, 3:] - expected).max() < 1e-4 * np.trace(expected)


def in_the_border(network: Network) -> NDArray[np.bool_]:
    return np.zeros(len(network.cameras), dtype=np.bool_)


def test_cameras_stand_with_their_images_or_in_the_border(monkeypatch: pytest.MonkeyPatch) -> None:
    # With one camera for two of the images, and c of some observed: both kinds at once.
    network = bench.network_of(make_bal.make(LONG), one_camera=False)
    shared = network.exposures.camera.copy()
    shared[1] = 0
    cameras = [replace(c, prior_sigma=np.where(np.arange(20) == 0, 5.0, np.inf)) for c in network.cameras]
    network = replace(
        network,
        cameras=(*cameras[:4], *network.cameras[4:]),
        exposures=replace(network.exposures, camera=np.maximum(shared - 1, 0)),
    )
    network = replace(network, cameras=network.cameras[:-1])
    one = fit(network)
    assert one.factored.problem.layout.with_image.sum() == LONG.images - 2
    monkeypatch.setattr(layout, "lone_cameras", in_the_border)
    other = fit(network)
    assert not other.factored.problem.layout.with_image.any()
    assert one.solution.chi_squared == pytest.approx(other.solution.chi_squared, rel=1e-12)
    sigma = np.sqrt(np.diagonal(other.solution.camera_covariance, axis1=1, axis2=2))[:, OF_LENS]
    assert np.abs((one.solution.cameras - other.solution.cameras)[:, OF_LENS] / sigma).max() < 1e-6
    for name in ("camera_covariance", "point_covariance", "exposure_covariance", "redundancy"):
        a, b = getattr(one.solution, name), getattr(other.solution, name)
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-7 * np.abs(b).max())


def test_what_is_asked_of_all_cameras_together(monkeypatch: pytest.MonkeyPatch) -> None:
    # Control fixes the datum; cameras whose images share no point are correlated, too.
    network = bench.network_of(make_bal.make(LONG), one_camera=False)
    weight = np.zeros((LONG.points, 3, 3))
    weight[::5] = np.eye(3) * 1e4
    network = replace(network, points=replace(network.points, weight=weight), datum_points=None)
    one = fit(network).factored
    monkeypatch.setattr(layout, "lone_cameras", in_the_border)
    other = fit(network).factored
    assert one.problem.layout.with_image.all()
    assert not other.problem.layout.with_image.any()
    a, b = calibration_of(one).covariance, calibration_of(other).covariance
    sigma = np.sqrt(np.maximum(np.diag(b), 1e-300))
    assert np.abs((a - b) / np.outer(sigma, sigma))[np.ix_(sigma > 1e-100, sigma > 1e-100)].max() < 1e-6
    a, b = (whole.covariance(network.cameras, network.mounting) for whole in map(condensed, (one, other)))
    root = np.sqrt(np.diag(b))
    assert np.abs((a - b) / np.outer(root, root)).max() < 1e-6


DAMAGED = [
    (TEXT.replace("2 2 4", "2 2 5"), "ends after 40 of 44 numbers", ""),
    (TEXT + "1.5\n", "more numbers than the 40", ""),
    (TEXT.replace("1 1 6.5", "1 7 6.5"), "observes point 7, but there are 2", "line 5"),
    (TEXT.replace("1 0 -5.5", "1.5 0 -5.5"), "observes camera 1.5", "line 4"),
    (TEXT.replace("1 0 -5.5", "-1 0 -5.5"), "observes camera -1", "line 4"),
    (TEXT.replace("-4.5", "nan"), "'nan' is not a finite number", "line 3"),
    (TEXT.replace("-4.5", "1e999"), "'1e999' is not a finite number", "line 3"),
    (TEXT.replace("-4.5", "4,5"), "'4,5' is not a finite number", "line 3"),
    (TEXT.replace("-4.5", "4.5.5"), "'4.5.5' is not a finite number", "line 3"),
    (TEXT.replace("-4.5", "4e6"), "more than 500000 px from the middle", "line 3"),
    (TEXT.replace("600.5", "-600.5"), "camera 0 has a focal length of -600.5", "line 12"),
    (TEXT.replace("2 2 4\n", "2 4\n"), "does not count", "line 1"),
    (TEXT.replace("2 2 4\n", "0 2 4\n"), "counts no cameras", "line 1"),
    (TEXT.replace("2 2 4\n", "2 2 999999999\n"), "more than the file can hold", "line 1"),
    (TEXT.replace("\n", ""), "does not count", "line 1"),
]


@pytest.mark.parametrize(("content", "what", "where"), DAMAGED, ids=[what for _, what, _ in DAMAGED])
@pytest.mark.parametrize("packed", [False, True])
def test_damaged_files_are_refused(tmp_path: Path, content: str, what: str, where: str, packed: bool) -> None:
    path = tmp_path / "problem-2-2.txt"
    path.write_bytes(bz2.compress(content.encode()) if packed else content.encode())
    with pytest.raises(InputMalformedError, match=what.replace(".", r"\.")) as refusal:
        bal.read(path)
    assert refusal.value.where.startswith(str(path))
    assert refusal.value.where.endswith(where)


def test_a_cut_archive_and_a_bomb_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "problem-2-2.txt.bz2"
    path.write_bytes(bz2.compress(TEXT.encode())[:-20])
    with pytest.raises(InputMalformedError, match="decompressed"):
        bal.read(path)
    path.write_bytes(bz2.compress(TEXT[:6].encode() + b" " * (100 << 20)))
    with pytest.raises(InputMalformedError, match="without a number"):
        bal.read(path)


def adopted(tmp_path: Path, problem: bal.BalProblem, command: str) -> tuple[int, str, Any]:
    path, out = tmp_path / "problem-9-90-pre.txt", tmp_path / "out"
    make_bal.write(problem, path)
    made = CliRunner().invoke(app, [command, str(path), "-o", str(out), "--json"])
    return made.exit_code, made.output, made.exception


def test_adjust_takes_the_file_and_writes_all_covariances(tmp_path: Path, problem: bal.BalProblem) -> None:
    path, out = tmp_path / "problem-9-90-pre.txt.bz2", tmp_path / "out"
    make_bal.write(problem, path)
    made = CliRunner().invoke(app, ["adjust", str(path), "-o", str(out), "--json"])
    assert made.exit_code == 0, made.output
    result = json.loads(made.stdout)
    assert len(result["cameras"]) == SMALL.images
    parameters = result["cameras"]["3"]["parameters"]
    assert {name for name, value in parameters.items() if value["sigma"] > 0} == {"c", "K1", "K2"}
    assert (out / "covariance.parquet").is_file()


def lessened(problem: bal.BalProblem) -> bal.BalProblem:
    """One point with one ray, and one behind its cameras at the start."""
    lost = np.flatnonzero(problem.point == 4)[1:]
    rays = np.delete(np.arange(len(problem.point)), lost)
    points = problem.points.copy()
    camera = problem.cameras[problem.image[problem.point == 9][0]]
    turn = Rotation.from_rotvec(camera[:3])
    centre = -turn.inv().apply(camera[3:6])
    points[9] = 2 * centre - points[9]
    return bal.BalProblem(
        problem.cameras, points, problem.image[rays], problem.point[rays], problem.plane[rays]
    )


def test_points_of_one_ray_are_named_and_points_behind_are_found_anew(
    tmp_path: Path, problem: bal.BalProblem
) -> None:
    less = lessened(problem)
    _, _, exception = adopted(tmp_path, less, "adjust")
    assert isinstance(exception, InputMalformedError)
    assert "tie point 4 has one ray" in str(exception)
    without = bench.without(less, ())
    assert len(without.points) == SMALL.points - 1
    found = adjust(bench.network_of(without, one_camera=False))
    assert found.chi_squared < without.plane.size


@pytest.mark.slow
def test_adopt_leaves_out_what_is_weak_and_says_so(tmp_path: Path, problem: bal.BalProblem) -> None:
    code, output, _ = adopted(tmp_path, lessened(problem), "adopt")
    assert code == 0, output
    remarks = json.loads((tmp_path / "out" / "adoption.json").read_text())["remarks"]
    assert any("1 points have one ray only: left out" in remark for remark in remarks)
    assert any("no size of the images" in remark for remark in remarks)


def test_other_texts_are_not_taken_for_it(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("3 4 5\nno problem here at all\n")
    assert not bal.detect(path)
    path.write_text(TEXT)
    assert bal.detect(path)
    assert read_foreign_project(path).program == "BAL"
