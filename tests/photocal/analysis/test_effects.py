"""Effect of parameters over the format, against closed forms and the Canon ELPH study."""

from __future__ import annotations

import numpy as np
import pytest

from photocal.analysis.estimates import Estimates, from_sigmas
from photocal.analysis.outcome import effects
from photocal.geometry.camera import Camera, camera

PITCH = 6.17219 / 4608


def canon_camera(values: Estimates) -> Camera:
    named = dict(zip(values.names, values.values.tolist(), strict=True))
    return camera(
        "canon", "brown-observed", "mm", (4608, 3456), (PITCH, PITCH), named, affinity_form="canon-elph"
    )


def test_dropping_k3_moves_the_edge_by_pixels(canon_sets: dict[str, Estimates]) -> None:
    """The study keeps K3 because without it the corrections change by 6 to 8 px at the edge of the frame."""
    values = canon_sets["1"]
    made = canon_camera(values)
    found = next(e for e in effects(made, values) if e.parameters == ("K3",))
    # K3 r^7 at the grid point farthest from the principal point.
    corner = (np.array([50, 3450]) - np.array([2303.5, 1727.5])) * PITCH * np.array([1, -1])
    r = np.linalg.norm(corner - made.values[1:3])
    assert found.largest_px == pytest.approx(made.value("K3") * r**7 / PITCH, rel=1e-6)
    assert 6.0 < found.largest_px < 12.0
    # K1 and K2 take most of it: why its F test finds nothing.
    assert found.remaining_rms_px < 0.2 * found.rms_px
    assert found.remaining_largest_px < 0.3 * found.largest_px


def test_a_shift_of_the_principal_point_moves_everything() -> None:
    made = camera("a", "brown-observed", "px", (4000, 3000), (1.0, 1.0), {"c": 3000.0, "x0": 7.0, "y0": 0.0})
    values = from_sigmas(("c", "x0", "y0"), [3000.0, 7.0, 0.0], [1.0, 0.1, 0.1])
    found = next(e for e in effects(made, values) if e.parameters == ("x0",))
    assert found.largest_px == pytest.approx(7.0, abs=1e-9)
    assert found.rms_px == pytest.approx(7.0, abs=1e-9)
    # A rotation imitates it to second order: x0 (x / c)^2 is left towards the edge.
    assert 0.5 < found.remaining_largest_px < 7.0


def test_every_parameter_but_c_and_every_group(canon_sets: dict[str, Estimates]) -> None:
    found = effects(canon_camera(canon_sets["1"]), canon_sets["1"])
    assert [e.parameters for e in found if len(e.parameters) > 1] == [
        ("x0", "y0"), ("K1", "K2", "K3"), ("P1", "P2"), ("B1", "B2"),
    ]  # fmt: skip
    assert ("c",) not in [e.parameters for e in found]
    affinity = next(e for e in found if e.parameters == ("B1", "B2"))
    # 0.6 px at the corner of the frame by the study's words, for its largest affinity; here 0.18.
    assert affinity.largest_px == pytest.approx(
        np.hypot(0.7730203e-4, 0.1877472e-4) * (2253.5 + 0.0625 / PITCH), rel=1e-3
    )
