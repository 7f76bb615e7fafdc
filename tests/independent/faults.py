"""Faults with the sizes of the review, the design that each is flown with, and the names that are right."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from tests.independent.flights import LEVER_M, USUAL, Design, Errors

BASE = Design("six control points")
FOUR, TEN = replace(BASE, name="four", control=4), replace(BASE, name="ten", control=10, check=20)
NO_CONTROL = replace(BASE, name="no control", control=0)
WEAK = replace(BASE, name="one height, no strips across", cross=False, images=24)
HELD_C = tuple(name for name in USUAL if name != "c")
WITHOUT_P = tuple(name for name in USUAL if not name.startswith("P"))
# Radius of the format's corner, px: what a term does there.
CORNER = 2500.0

# Clean designs: whatever is found in them is invented. The last ones have what no block states.
CLEAN = (
    BASE,
    FOUR,
    TEN,
    NO_CONTROL,
    WEAK,
    replace(WEAK, name="one height, no control", control=0),
    replace(BASE, name="boresight stated", boresight="stated", sigma_px=0.3),
    replace(BASE, name="eight images", images=8, cross=False, check=5, sigma_px=1.5, per_image=60),
    replace(BASE, name="control alone", gnss=False, control=10),
    replace(BASE, name="60 images, 30 check points", images=60, check=30, sigma_px=1.0),
    replace(BASE, name="151 images", images=151, control=10, check=20),
    replace(BASE, name="580 images", images=580, control=10, check=30, per_image=60),
)
UNUSUAL = (
    replace(BASE, name="Student t, 3 degrees", tails="t3"),
    replace(BASE, name="Student t, 4 degrees", tails="t4"),
    replace(BASE, name="a tenth three times as bad", tails="mixture"),
    replace(BASE, name="GNSS remembers, AR(1) 0.95", memory=0.95),
    replace(BASE, name="rays 1.5 times worse", rays_worse=1.5),
    replace(BASE, name="positions 1.5 times worse", gnss_worse=1.5),
)
# Kilometres above ground, with a lens that is known but for c and its principal point.
HIGH = replace(BASE, name="10 km high", height_m=10_000.0, images=80, estimate=("c", "x0", "y0"))
LARGE = replace(TEN, name="200 images", height_m=200.0, images=200, per_image=60)
ROLLING = replace(BASE, name="shutter unknown", shutter="unknown")
# Steps from image to image that a shutter of 15 ms makes.
ESTIMATED = replace(ROLLING, name="15 ms, estimated", readout_s=0.015)


@dataclass(frozen=True)
class Fault:
    """What is wrong in a flight, and what it may be called.

    Attributes
    ----------
    names
        Codes of findings that name it.
    subjects
        What those findings must be about, where that is a point, an image or a strip.
    """

    name: str
    errors: Errors
    names: tuple[str, ...]
    subjects: tuple[str, ...] = ()
    design: Design = field(default=BASE)


POINT = ("control-mistyped", "control-contradicts", "control-point", "control-pair")
SWAP = (*POINT, "control-swapped", "control-exchanged")
_UP, _EAST = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)


def _off(size: float, axis: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = (size * np.array(axis)).tolist()
    return x, y, z


def _points(design: Design, size: float, axis: tuple[float, float, float], *at: int) -> Errors:
    return Errors(control=tuple((k, _off(size, axis)) for k in at))


def _control(name: str, size: float, axis: tuple[float, float, float], design: Design, *at: int) -> Fault:
    return Fault(name, _points(design, size, axis, *at), POINT, tuple(f"co{k}" for k in at), design)


def _lens(name: str, codes: tuple[str, ...], estimate: tuple[str, ...] = USUAL, **terms: float) -> Fault:
    return Fault(name, Errors(lens=tuple(terms.items())), codes, design=replace(BASE, estimate=estimate))


def _terms() -> tuple[Fault, ...]:
    k3, k4 = 4.0 / CORNER**7, 4.0 / CORNER**9
    with_k3 = (*USUAL, "K3")
    return (
        _lens("K3, 4 px at the corner", ("radial", "lens-model"), K3=k3),
        _lens("K4, 4 px at the corner", ("radial", "lens-model"), with_k3, K4=k4),
        _lens("P1, P2 left out", ("decentring", "lens-model"), WITHOUT_P, P1=1e-7, P2=-1e-7),
        _lens("y scale 1e-4", ("y-scale",), y_scale=1e-4),
        _lens("y scale 1e-3", ("y-scale",), y_scale=1e-3),
        _lens("shear 1e-4", ("shear",), shear=1e-4),
        _lens("shear 1e-3", ("shear",), shear=1e-3),
    )


def _shutters() -> tuple[Fault, ...]:
    rolls, told = ("rolling-shutter", "shutter-rolls"), replace(WEAK, name="one height", control=6)
    return tuple(
        Fault(f"rolling {1e3 * s:.0f} ms{where}", Errors(readout_s=s), rolls, design=design)
        for where, design in (("", BASE), (", no strips across", told), (", shutter unknown", ROLLING))
        for s in (0.003, 0.015, 0.040)
    )


def _held(share: float, design: Design) -> Fault:
    held = replace(design, estimate=HELD_C)
    return Fault(
        f"c held {share:.2%} wrong, {design.name}", Errors(c_stated=share), ("principal-distance",), (), held
    )


def table() -> tuple[Fault, ...]:
    """List all faults that are looked for with their sizes."""
    change = ("camera-change", "c-step")
    shift = ("base-position", "datum-shift")
    worse = ("gross-rays",)
    return (
        Fault("time 20 ms", Errors(time_offset_s=0.020), ("time-offset",)),
        Fault("time 50 ms", Errors(time_offset_s=0.050), ("time-offset",)),
        Fault("lever arm 20 cm right", Errors(lever_arm_m=(0.0, 0.2, 0.0)), ("lever-arm",)),
        Fault("lever arm 5 cm right", Errors(lever_arm_m=(0.0, 0.05, 0.0)), ("lever-arm",)),
        Fault(
            "lever arm, axes exchanged",
            Errors(stated_lever_m=(LEVER_M[1], LEVER_M[0], LEVER_M[2])),
            ("lever-arm-axes", "lever-arm"),
        ),
        Fault("base 30 cm in plane", Errors(datum_m=(0.2, -0.22, 0.0)), shift),
        Fault("antenna 0.5 m", Errors(datum_m=(0.0, 0.0, 0.5)), ("antenna-height", "datum-shift")),
        *(Fault(f"c step {s:.1%}", Errors(c_step=s), change) for s in (0.001, 0.002, 0.005)),
        *(_held(s, design) for s in (0.0005, 0.001, 0.005) for design in (BASE, NO_CONTROL)),
        *(
            _control(f"one of {d.control} control points, {100 * s:.0f} cm {what}", s, axis, d, 1)
            for d in (FOUR, BASE, TEN)
            for s in (0.10, 0.30)
            for what, axis in (("Z", _UP), ("in plane", _EAST))
        ),
        _control("two control points, 30 cm Z", 0.3, _UP, BASE, 1, 3),
        _control("two control points, 30 cm in plane", 0.3, _EAST, BASE, 1, 3),
        _control("three of ten control points, 30 cm Z", 0.3, _UP, TEN, 1, 4, 7),
        Fault("two control points swapped", Errors(swapped=(0, 1)), SWAP, ("co0", "co1")),
        Fault("two near control points swapped", Errors(swapped=(4, 5)), SWAP, ("co4", "co5")),
        Fault("two digits of a control point", Errors(slip=2), POINT, ("co2",)),
        *_shutters(),
        *_terms(),
        Fault(
            "one position 0.3 m",
            Errors(position=((12, (0.3, 0.0, 0.0)),)),
            ("position-contradicts", "position"),
            ("IMG_0012",),
        ),
        Fault("positions' scale 400 ppm", Errors(plane_scale=4e-4), ("positions-scale", "scale"), (), TEN),
        Fault(
            "control 400 ppm, ground for grid", Errors(control_scale=4e-4), ("positions-scale",), (), LARGE
        ),
        Fault("curved earth, 10 km high", Errors(curved=True), ("earth-curvature",), (), HIGH),
        Fault("refraction 0.17, 10 km high", Errors(refraction=0.17), ("refraction",), (), HIGH),
        Fault("GNSS 5 cm low", Errors(datum_m=(0.0, 0.0, -0.05)), ()),
        Fault("datum 5 cm low, no control", Errors(datum_m=(0.0, 0.0, -0.05)), (), (), NO_CONTROL),
        Fault("2 % of rays 20 times worse", Errors(gross=0.02), worse),
        Fault("5 % of rays 20 times worse", Errors(gross=0.05), worse),
    )
