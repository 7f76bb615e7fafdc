"""What an adjustment estimates of shutters and of shaking images: notes, for the model has them."""

from collections.abc import Iterable, Mapping

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.readout import READOUT, Readout, readout_of
from photocal.findings.finding import Finding
from photocal.geometry.camera import Camera

OF_SHUTTERS = ("shutter-rolls", "images-shake")


def shutter_findings(cameras: Mapping[str, Camera], readouts: Iterable[Readout]) -> tuple[Finding, ...]:
    """Tell of each readout that was estimated, and of each camera whose images shake while they are read."""
    rolls, shakes = OF_SHUTTERS
    listed = list[Finding]()
    for readout in readouts:
        if readout.estimated:
            effect_px = readout.effect / cameras[readout.camera].pitch[0]
            figures = {"camera": readout.camera, "effect_px": effect_px, "way_m": readout.way}
            figures |= {"value_ms": 1e3 * readout.value, "sigma_ms": 1e3 * readout.sigma}
            listed.append(Finding(rolls, "note", readout.camera, figures))
    for name, camera in cameras.items():
        if camera.shake:
            figures = {"camera": name, "effect_px": camera.shaken / camera.pitch[0]}
            listed.append(Finding(shakes, "note", name, figures))
    return tuple(listed)


def shutters_of(adjusted: AdjustedNetwork) -> tuple[Finding, ...]:
    """Tell the same of an adjusted network, whose shutters are known or estimated."""
    network = adjusted.network
    estimated = [k for k, camera in enumerate(network.cameras) if camera.estimated[READOUT]]
    readouts = (readout_of(network, adjusted.solution, k) for k in estimated)
    return shutter_findings({camera.id: camera for camera in network.cameras}, readouts)
