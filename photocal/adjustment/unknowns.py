"""What the unknowns of the reduced system are called, and in which unit a person reads them."""

from dataclasses import dataclass

import numpy as np

from photocal.adjustment.lasers import OF_LASER, SCALE
from photocal.adjustment.mounting import BORESIGHT, COMMON, HEIGHT_SCALE, STRIPS, TIME
from photocal.adjustment.network import Network, own_parameters
from photocal.adjustment.normal import Problem
from photocal.adjustment.rig import CENTRE, OF_HEAD, TURN
from photocal.geometry.camera import OWN, PARAMETERS

POSE_NAMES = ("omega", "phi", "kappa", "X", "Y", "Z")
XYZ = ("X", "Y", "Z")


@dataclass(frozen=True)
class Unknown:
    """One unknown.

    of: name of the image, camera, head of a rig (that of its camera) or point; empty for the mounting.
    unit: in which it is printed; empty for coefficients of distortion.
    scale: that unit per unit of the adjustment.
    """

    kind: str
    of: str
    parameter: str
    unit: str
    scale: float = 1.0

    @property
    def name(self) -> str:
        """Such as `Z of image 12`."""
        return f"{self.parameter} of {self.kind} {self.of}" if self.of else self.parameter


def unknowns(problem: Problem) -> list[Unknown | None]:
    """Name the columns of the reduced system; None for those that are no unknowns.

    returns: one entry for each column.
    """
    network, layout, parameters = problem.network, problem.layout, own_parameters(problem.network)
    named: list[Unknown | None] = [None] * layout.size
    for i, image in enumerate(network.image_names):
        for column, parameter in zip(layout.image_columns[i], POSE_NAMES, strict=True):
            angle = parameter not in XYZ
            named[column] = Unknown(
                "image", image, parameter, "deg" if angle else "m", np.degrees(1.0) if angle else 1.0
            )
        unit = network.cameras[network.exposures.camera[i]].unit
        for column, k in zip(layout.own_columns[i], parameters[i], strict=True):
            if k >= 0:
                named[column] = Unknown("image", image, OWN[k], *_unit(unit, OWN[k]))
    for camera, (active, columns) in zip(network.cameras, layout.camera_columns, strict=True):
        for k, column in zip(active, columns, strict=True):
            named[column] = Unknown("camera", camera.id, PARAMETERS[k], *_unit(camera.unit, PARAMETERS[k]))
    for column, common in zip(layout.common_columns, common_unknowns(network), strict=True):
        if column >= 0:
            named[column] = common
    for j, columns in zip(layout.kept_points, layout.point_columns, strict=True):
        for column, parameter in zip(columns, XYZ, strict=True):
            named[column] = Unknown("point", network.point_names[j], parameter, "m")
    return [None if held else unknown for unknown, held in zip(named, problem.held, strict=True)]


def common_unknowns(network: Network) -> list[Unknown]:
    """Name the common values of the mounting, of lasers and of the heads of rigs, in their order."""
    named = []
    for k in range(len(network.mounting.values)):
        if k < STRIPS:
            angle = BORESIGHT.start <= k < BORESIGHT.stop
            unit = {TIME: "s", HEIGHT_SCALE: ""}.get(k, "deg" if angle else "m")
            scale = np.degrees(1.0) if angle else 1.0
            named.append(Unknown("mounting", "", COMMON[k], unit, scale))
            continue
        strip, place = divmod(k - STRIPS, 6)
        what, unit = ("shift", "m") if place < 3 else ("drift", "m/s")
        named.append(Unknown("mounting", "", f"{what}_{'xyz'[place % 3]}[{strip}]", unit))
    for k, _ in enumerate(network.lasers.common_sigma):
        named.append(Unknown("laser", "", OF_LASER[k], "" if k == SCALE else "m"))
    for camera in network.rig.camera:
        units = np.array(["s"] * len(OF_HEAD), dtype=object)
        units[TURN], units[CENTRE] = "deg", "m"
        for name, unit in zip(OF_HEAD, units, strict=True):
            scale = np.degrees(1.0) if unit == "deg" else 1.0
            named.append(Unknown("head", network.cameras[camera].id, name, unit, scale))
    return named


def _unit(unit: str, parameter: str) -> tuple[str, float]:
    """In which a parameter is printed, and that unit per unit of the adjustment."""
    if parameter.startswith(("turn", "shake")):
        return "deg", float(np.degrees(1.0))
    if parameter.startswith("move"):
        return "m", 1.0
    return "s" if parameter == "readout" else unit if parameter in ("c", "x0", "y0") else "", 1.0
