"""The one table of what may be wrong: what a fault adds, its prior, what it looks like, what follows of it.

Search, names, words, root causes and the page of documentation come from here. A new fault is one entry and
its texts: `term.CODE`, `finding.CODE`, perhaps `remedy.CODE`, in both catalogues.
"""

from dataclasses import dataclass
from typing import Literal

from photocal.findings.texts import Words

Where = Literal["positions", "camera", "attitudes", "control", "time"]
Each = Literal["block", "strip", "one-strip", "part", "field", "image", "point", "pair", "trend"]

# Whatever is wrong shows at ground points and in tests; a method may be refused for it.
SYMPTOMS = (
    "check-outside-prediction",
    "control-outside-prediction",
    "prediction-too-good",
    "check-mean",
    "global-test",
    "sigmas-too-small",
    "method-refused",
)


@dataclass(frozen=True)
class Fault:
    """One thing that may be wrong.

    where: what it falsifies.
    frees: what it adds as unknowns: names of the mounting's common values (`adjustment.mounting.COMMON`) or
        of camera parameters; nothing for a field of displacements, a wrong observation, or what is found in
        another way.
    each: for what those are freed: once, for each strip, for one strip, for the images before and after a
        change of the camera; or what is wrong: a field of one camera's rays, the position of one image, a
        control point or several, a pair of them that changed places, a trend of all positions.
    prior: what a freed value may be at most, as a weak observation that keeps the network regular: m, rad, s;
        for camera parameters a share of c.
    imitates: what it looks like: "*" for whatever else there is.
    contains: faults that it contains: beside it they are not tested, and it is no other name for them.
    kind_of: the fault that it is a special case of.
    model: whether it is the model of a camera that lacks something, rather than what was done wrong.
    """

    code: str
    where: tuple[Where, ...]
    frees: tuple[str, ...] = ()
    each: Each = "block"
    prior: float = 0.0
    imitates: tuple[str, ...] = ()
    contains: tuple[str, ...] = ()
    kind_of: str = ""
    symptoms: tuple[str, ...] = SYMPTOMS
    model: bool = False


_XYZ = ("x", "y", "z")
_SHIFT = tuple(f"shift_{a}" for a in _XYZ)
_OF_DATUM = ("antenna-height", "base-position", "datum-shift")
_OF_STRIPS = ("strip-shifts", "strip-position")
_OF_POSITIONS = (*_OF_DATUM, "lever-arm", "lever-arm-axes", *_OF_STRIPS, "time-offset")
# Images of two scales are pressed into one by what each may move while it is read.
_OF_CHANGE = (*SYMPTOMS, "shutter-rolls", "images-shake")


@dataclass(frozen=True)
class AddedFault(Words):
    """A fault that an installed package brings (group `photocal.hypotheses`), with its texts.

    words: by language "term.CODE", "finding.CODE" and "remedy.CODE"; English where another is lacking.
    """

    fault: Fault


# In the order in which they are tested.
OWN: tuple[Fault, ...] = (
    Fault(
        "camera-change",
        ("camera",),
        ("c",),
        "part",
        0.1,
        ("*",),
        ("principal-distance",),
        symptoms=_OF_CHANGE,
    ),
    Fault("lever-arm", ("positions",), tuple(f"lever_arm_{a}" for a in _XYZ), prior=100.0),
    Fault("antenna-height", ("positions",), ("shift_z",), prior=1000.0, kind_of="datum-shift"),
    Fault("base-position", ("positions",), _SHIFT[:2], prior=1000.0, kind_of="datum-shift"),
    Fault("datum-shift", ("positions",), _SHIFT, prior=1000.0, contains=("antenna-height", "base-position")),
    Fault("boresight", ("attitudes",), tuple(f"boresight_{a}" for a in _XYZ), prior=1.0),
    Fault("time-offset", ("positions", "time"), ("time_offset",), prior=10.0),
    Fault("strip-shifts", ("positions",), _SHIFT, "strip", 1000.0, ("*",), (*_OF_DATUM, "strip-position")),
    Fault("strip-position", ("positions",), _SHIFT, "one-strip", 1000.0),
    Fault("principal-distance", ("camera",), ("c",), prior=0.1),
    Fault("principal-point", ("camera",), ("x0", "y0"), prior=0.1),
    Fault("rolling-shutter", ("camera",), (), "field", model=True),
    Fault("c-drift", ("camera",), (), "field", model=True),
    Fault("y-scale", ("camera",), (), "field", model=True),
    Fault("shear", ("camera",), (), "field", model=True),
    Fault("radial", ("camera",), (), "field", model=True),
    Fault("decentring", ("camera",), (), "field", model=True),
    Fault("refraction", ("camera",), (), "field", model=True),
    Fault("earth-curvature", ("camera",), (), "field", model=True),
    # The place about which coordinates were scaled is nobody's: a shift goes with a scale.
    Fault("positions-scale", ("positions",), _SHIFT[:2], "trend", 1000.0, contains=("base-position",)),
    Fault("position-contradicts", ("positions",), (), "image"),
    Fault("control-mistyped", ("control",), (), "point"),
    Fault("control-exchanged", ("control",), (), "pair"),
    Fault("lever-arm-axes", ("positions",), kind_of="lever-arm"),
    Fault("head-moved", ("camera",)),
    Fault("ppk-not-fixed", ("positions",), imitates=_OF_POSITIONS),
    Fault("autopilot-clock", ("attitudes", "time")),
    Fault("event-time-base", ("time",)),
    Fault("height-kind", ("positions",)),
)
