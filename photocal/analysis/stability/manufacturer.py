"""Parameters of a manufacturer, in the normalised model of Pix4D, as a Brown camera."""

from __future__ import annotations

from photocal.geometry.camera import Camera, camera

PIX4D_PARAMETERS = ("f", "Px", "Py", "R1", "R2", "R3", "T1", "T2")


def brown_from_pix4d(
    camera_id: str, size_px: tuple[int, int], pitch_mm: tuple[float, float], parameters: dict[str, float]
) -> Camera:
    """Convert Pix4D's parameters in mm to a camera with the same distortion.

    Pix4D evaluates its polynomial at ideal coordinates divided by f, with y down from the corner; so the
    result is a `brown-ideal` camera and nothing is fitted: K_n = R_n / f^(2n), P1 = T2 / f, P2 = -T1 / f.

    Notes
    -----
    Canon ELPH study (FCT-UNESP), box 1.
    """
    f = parameters["f"]
    width, height = size_px[0] * pitch_mm[0], size_px[1] * pitch_mm[1]
    values = {
        "c": f,
        "x0": parameters["Px"] - width / 2.0,
        "y0": height / 2.0 - parameters["Py"],
        "K1": parameters.get("R1", 0.0) / f**2,
        "K2": parameters.get("R2", 0.0) / f**4,
        "K3": parameters.get("R3", 0.0) / f**6,
        "P1": parameters.get("T2", 0.0) / f,
        "P2": -parameters.get("T1", 0.0) / f,
    }
    return camera(camera_id, "brown-ideal", "mm", size_px, pitch_mm, values)
