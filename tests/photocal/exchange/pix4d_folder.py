"""A `params` folder as Pix4Dmapper leaves it, written from a reconstruction: the heads of real files.

The layout is that of the description of real projects (581 images of one camera, and rigs of five); nothing
of it is taken from the reader.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from photocal.block.model import Block, Role
from photocal.exchange.pinhole import Pinhole, to_pinhole, to_vision
from tests.photocal.exchange.conftest import of_role

Floats = NDArray[np.float64]
ERRORS_HEAD = (
    "imageName, cameraIndex, cameraName, X_opt, Y_opt, Z_opt, X_gps, Y_gps, Z_gps, X_acc, Y_acc, Z_acc, "
    "Omega, Phi, Kappa, X_uncertainty, Y_uncertainty, Z_uncertainty, Omega_uncertainty, Phi_uncertainty, "
    "Kappa_uncertainty, inlierProb"
)
GROUND_HEAD = (
    "GCP label, GCP measured X, GCP measured Y, GCP measured Z, GCP estimated X, GCP estimated Y, "
    "GCP estimated Z, GCP weight, GCP visible in # images"
)
# Weights of surveyed points come near to 1; that of a manual tie point is it.
SURVEYED, MANUAL = 0.9999997, 1.0


def digits(values: Sequence[float] | Floats) -> list[str]:
    """Numbers as Pix4Dmapper writes them."""
    return [f"{float(value):.20f}" for value in values]


def write_params(
    folder: Path,
    given: Block,
    *,
    name: str = "field 3",
    manual: Sequence[int] = (),
    offset: Floats | None = None,
    positions: Floats | None = None,
    accuracy_m: float = 0.02,
    system: str = "",
    estimated: Floats | None = None,
) -> None:
    """Write the folder.

    given: in map coordinates. manual: tie points that a person has marked; the first has zeros as its
    "measured" place, the others what the program computed in an earlier state, 0.28 m lower.
    positions (images, 3): by GNSS; as adjusted without them. estimated (points, 3): adjusted coordinates of
    marked points. system: WKT of the output system.
    """
    at = np.zeros(3) if offset is None else offset
    adjusted = given.points.values if estimated is None else estimated
    places = given.images.values[:, 3:]
    rotation, _ = to_vision(given.images.values)
    lenses = [to_pinhole(camera, "Pix4D")[0] for camera in given.cameras]
    pitches = [camera.pitch[0] if camera.unit == "mm" else 0.005 for camera in given.cameras]
    files = {
        "calibrated_camera_parameters.txt": _cameras(given, lenses, places - at, rotation),
        "calibrated_external_camera_parameters.txt": _table(
            "imageName X Y Z Omega Phi Kappa",
            given.images.names,
            np.column_stack([places, np.degrees(given.images.values[:, :3])]),
            " ",
        ),
        "calibrated_external_camera_parameters_error.txt": _errors(
            given, places if positions is None else positions, accuracy_m
        ),
        "calibrated_images_position.txt": _table("", given.images.names, places, ","),
        "offset.xyz": " ".join(digits(at)),
        "measured_estimated_gcps_position.txt": _ground(given, manual, adjusted),
        "measured_gcps_position.txt": "\n".join(
            " ".join(digits(given.points.values[k]))
            for k in [*of_role(given, "control"), *of_role(given, "check"), *manual]
        ),
        "estimated_gcps_position.txt": "\n".join(
            ", ".join([given.points.names[k], *digits(adjusted[k])])
            for k in [*of_role(given, "control"), *of_role(given, "check"), *manual]
        ),
        "pmatrix.txt": _pmatrix(given, lenses, places - at, rotation),
        "pix4d_calibrated_internal_camera_parameters.cam": _cam(lenses, pitches),
        "calibrated_internal_camera_parameters.cam": _inpho(lenses, pitches),
    }
    if system:
        files["wkt.prj"] = system
    for ending, text in files.items():
        (folder / f"{name}_{ending}").write_text(text + "\n", encoding="utf-8")
    _bingo(
        folder / f"{name}_tp_bingo.txt",
        given,
        pitches,
        {*of_role(given, "control"), *of_role(given, "check"), *manual},
    )


def _table(head: str, names: Sequence[str], values: Floats, between: str) -> str:
    rows = (between.join([name, *digits(row)]) for name, row in zip(names, values, strict=True))
    return "\n".join([head, *rows] if head else rows)


def _matrix(lens: Pinhole) -> Floats:
    """K of a program whose upper-left pixel has its corner at (0, 0)."""
    return np.array([[lens.fx, 0, lens.cx + 0.5], [0, lens.fy, lens.cy + 0.5], [0, 0, 1]])


def _cameras(given: Block, lenses: Sequence[Pinhole], places: Floats, rotation: Floats) -> str:
    head = "\n".join(
        [
            "fileName imageWidth imageHeight ",
            "camera matrix K [3x3]",
            "radial distortion [3x1]",
            "tangential distortion [2x1]",
            "camera position t [3x1]",
            "camera rotation R [3x3]",
            "camera model m = K [R|-Rt] X",
            "",
        ]
    )
    rows = [head]
    for k, name in enumerate(given.images.names):
        lens = lenses[given.images.camera[k]]
        width, height = lens.size_px
        numbers = [*_matrix(lens), [lens.k1, lens.k2, lens.k3], [lens.p1, lens.p2], places[k], *rotation[k]]
        rows += [f"{name} {width} {height}", *(" ".join(digits(row)) for row in numbers)]
    return "\n".join(rows)


def _errors(given: Block, positions: Floats, accuracy_m: float) -> str:
    rows = [ERRORS_HEAD]
    for k, name in enumerate(given.images.names):
        which = given.images.camera[k]
        width, height = given.cameras[which].size_px
        cells = [
            *given.images.values[k, 3:],
            *positions[k],
            *[accuracy_m] * 3,
            *np.degrees(given.images.values[k, :3]),
        ]
        cells += [0.004] * 3 + [0.002] * 3 + [0.99]
        rows.append(
            ", ".join([name, str(which), f"Own Camera{which}_20.0_{width}x{height} (RGB)(1)", *digits(cells)])
        )
    return "\n".join(rows)


def _ground(given: Block, manual: Sequence[int], adjusted: Floats) -> str:
    rays = np.bincount(given.observations.point, minlength=len(given.points.values))
    rows = [GROUND_HEAD]
    for k in [*of_role(given, "control"), *of_role(given, "check"), *manual]:
        measured = given.points.values[k]
        if k in manual:
            measured = np.zeros(3) if k == manual[0] else measured - [0, 0, 0.28]
        weight = MANUAL if k in manual else SURVEYED
        rows.append(
            ", ".join([given.points.names[k], *digits([*measured, *adjusted[k], weight]), str(rays[k])])
        )
    return "\n".join(rows)


def _pmatrix(given: Block, lenses: Sequence[Pinhole], places: Floats, rotation: Floats) -> str:
    rows = []
    for k, name in enumerate(given.images.names):
        turned = np.column_stack([rotation[k], -rotation[k] @ places[k]])
        rows.append(" ".join([name, *digits((_matrix(lenses[given.images.camera[k]]) @ turned).ravel())]))
    return "\n".join(rows)


def _cam(lenses: Sequence[Pinhole], pitches: Sequence[float]) -> str:
    rows = []
    for k, (lens, pitch) in enumerate(zip(lenses, pitches, strict=True)):
        width, height = lens.size_px
        rows += [
            f"Pix4D camera calibration file {k}",
            "",
            f"#Focal Length mm assuming a sensor width of {width * pitch:.20f}x{height * pitch:.20f}mm",
            f"F {lens.fx * pitch:.20f}",
            "",
            "#Principal Point mm",
            f"Px {(lens.cx + 0.5) * pitch:.20f}",
            f"Py {(lens.cy + 0.5) * pitch:.20f}",
            "",
            "#Symmetrical Lens Distortion Coeffs",
            *(f"K{n} {getattr(lens, f'k{n}'):.20f}" for n in (1, 2, 3)),
            "",
            "#Tangential Lens Distortion Coeffs",
            *(f"T{n} {getattr(lens, f'p{n}'):.20f}" for n in (1, 2)),
            "",
        ]
    return "\n".join(rows)


def _inpho(lenses: Sequence[Pinhole], pitches: Sequence[float]) -> str:
    rows = []
    for lens, pitch in zip(lenses, pitches, strict=True):
        width, height = lens.size_px
        x, y = (lens.cx + 0.5 - width / 2) * pitch, (height / 2 - lens.cy - 0.5) * pitch
        rows += [
            "VERSION 3.0",
            f"#Focal Length mm assuming a sensor width of {width * pitch:.20f}x{height * pitch:.20f}mm",
            f"FOCAL {lens.fx * pitch:.20f}",
            "#Principal Point Offset xpoff ypoff in mm (Inpho)",
            f"XPOFF {x:.20f}",
            f"YPOFF {y:.20f}",
            "#Principal Point Offset xpoff ypoff in mm, x mirrored",
            f"#XPOFF {-x:.20f}",
            f"#YPOFF {y:.20f}",
            "#Principal Point Offset in pixel",
            f"#XPOFF {lens.cx + 0.5:.20f}",
            f"#YPOFF {lens.cy + 0.5:.20f}",
        ]
    return "\n".join(rows)


def _bingo(path: Path, given: Block, pitches: Sequence[float], marked: set[int]) -> None:
    names = [f"GCP_{name}" if k in marked else name for k, name in enumerate(given.points.names)]
    order = np.argsort(given.observations.image, kind="stable")
    bounds = np.searchsorted(given.observations.image[order], np.arange(len(given.images.names) + 1))
    with path.open("w", encoding="utf-8") as out:
        for k, image in enumerate(given.images.names):
            which = given.images.camera[k]
            (width, height), pitch = given.cameras[which].size_px, pitches[which]
            out.write(f"{Path(image).stem} H{which}_{width * pitch:.4f}_{height * pitch:.4f}\n")
            rays = order[bounds[k] : bounds[k + 1]]
            x = (given.observations.values[rays, 0] - (width - 1) / 2) * pitch
            y = ((height - 1) / 2 - given.observations.values[rays, 1]) * pitch
            out.writelines(
                f"{names[p]} {a:.20f} {b:.20f}\n"
                for p, a, b in zip(given.observations.point[rays], x, y, strict=True)
            )
            out.write("-99\n")


REPORT_HEAD = (
    "GCP Name | Accuracy XY/Z [m] | Error X [m] | Error Y [m] | Error Z [m] | "
    "Projection Error [pixel] | Verified/Marked"
)
RMS = {"control": "0.012 | 0.013 | 0.014", "check": "0.021 | 0.022 | 0.023"}


def write_report(path: Path, given: Block, *, mean_px: float, sigma_px: Floats) -> None:
    """Write the report of such a project as a page; the rows of its tables have the columns of real ones.

    sigma_px (cameras, 3): of c, x0 and y0.
    """
    count = len(given.images.names)
    rows = [
        "Quality Report", "Generated with Pix4Dmapper version 4.5.6",
        f"Dataset | {count} out of {count + 2} images calibrated (99%), all images enabled",
        f"Mean Reprojection Error [pixels] | {mean_px:.3f}",
    ]  # fmt: skip
    rows += [
        f"Uncertainties (Sigma) | {c:.6f} [pixel] {c / 200:.6f} [mm] | {x:.6f} [pixel] 0.0 [mm] | "
        f"{y:.6f} [pixel] 0.0 [mm] | 0.000 | 0.000 | 0.000 | 0.000 | 0.000"
        for c, x, y in sigma_px
    ]
    heads: tuple[tuple[Role, str], ...] = (
        ("control", REPORT_HEAD),
        ("check", REPORT_HEAD.replace("GCP Name", "Check Point Name")),
    )
    for role, head in heads:
        names = [given.points.names[k] for k in of_role(given, role)]
        rows += [head]
        rows += [f"{name} (3D) | 0.020/ 0.030 | 0.011 | -0.012 | 0.013 | 0.402 | 4 / 4" for name in names]
        rows += ["Mean [m] | 0.001 | 0.002 | 0.003", "Sigma [m] | 0.011 | 0.012 | 0.013"]
        rows += [
            "RMS Error [m] | 0.012 | 0.013 | 0.014"
            if role == "control"
            else "RMS Error [m] | 0.021 | 0.022 | 0.023"
        ]
    cells = (row.replace(" | ", "</td><td>") for row in rows)
    body = "\n".join(f"<tr><td>{row}</td></tr>" for row in cells)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"<html><body><table>{body}</table></body></html>", encoding="utf-8")
