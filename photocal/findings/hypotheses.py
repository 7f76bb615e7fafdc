"""The one table of what may be wrong: what a fault frees, its prior, what it looks like, what follows of it.

Search, names, words, root causes and the page of documentation come from here. A new fault is one entry and
its texts: `term.CODE`, `finding.CODE`, perhaps `remedy.CODE`, in both catalogues.
"""

from dataclasses import dataclass
from typing import Literal

Where = Literal["positions", "camera", "attitudes", "control", "time"]

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
    frees: what the search frees in the integrated adjustment: names of the mounting's common values
        (`adjustment.mounting.COMMON`) or of camera parameters; nothing for what is found in another way.
    each: for what those are freed: once, for each strip, for the images before and after a change of camera.
    prior: what a freed value may be at most, as a weak observation that keeps the network regular: m, rad, s;
        for camera parameters a share of c.
    imitates: what it looks like: "*" for whatever else there is, so that it is tried when nothing else is
        left.
    contains: faults that it contains: beside it they are not tested, and it is no other name for them.
    kind_of: the fault that it is a special case of: found as that one, then named.
    """

    code: str
    where: tuple[Where, ...]
    frees: tuple[str, ...] = ()
    each: Literal["block", "strip", "part"] = "block"
    prior: float = 0.0
    imitates: tuple[str, ...] = ()
    contains: tuple[str, ...] = ()
    kind_of: str = ""
    symptoms: tuple[str, ...] = SYMPTOMS


_XYZ = ("x", "y", "z")
_OF_DATUM = ("antenna-height", "base-position", "datum-shift")
_OF_POSITIONS = (*_OF_DATUM, "lever-arm", "lever-arm-axes", "strip-shifts", "time-offset")
_OF_CAMERA = ("boresight", "camera-change", "principal-distance", "principal-point")

# In the order in which they are tested.
FAULTS: tuple[Fault, ...] = (
    Fault(
        "camera-change",
        ("camera",),
        ("c",),
        "part",
        0.1,
        imitates=("*",),
        contains=("principal-distance",),
        # Images of two scales are pressed into one by what each may move while it is read.
        symptoms=(*SYMPTOMS, "shutter-rolls", "images-shake"),
    ),
    Fault("lever-arm", ("positions",), tuple(f"lever_arm_{a}" for a in _XYZ), prior=100.0),
    Fault("datum-shift", ("positions",), tuple(f"shift_{a}" for a in _XYZ), prior=1000.0),
    Fault("boresight", ("attitudes",), tuple(f"boresight_{a}" for a in _XYZ), prior=1.0),
    Fault("time-offset", ("positions", "time"), ("time_offset",), prior=10.0),
    Fault(
        "strip-shifts",
        ("positions",),
        tuple(f"shift_{a}" for a in _XYZ),
        "strip",
        1000.0,
        imitates=("*",),
        contains=("datum-shift",),
    ),
    Fault("principal-distance", ("camera",), ("c",), prior=0.1),
    Fault("principal-point", ("camera",), ("x0", "y0"), prior=0.1),
    Fault("antenna-height", ("positions",), kind_of="datum-shift"),
    Fault("base-position", ("positions",), kind_of="datum-shift"),
    Fault("lever-arm-axes", ("positions",), kind_of="lever-arm"),
    Fault("rolling-shutter", ("camera",), imitates=(*_OF_POSITIONS, *_OF_CAMERA)),
    Fault("c-drift", ("camera",), imitates=(*_OF_POSITIONS, *_OF_CAMERA)),
    Fault("head-moved", ("camera",)),
    Fault("ppk-not-fixed", ("positions",), imitates=_OF_POSITIONS),
    Fault("control-mistyped", ("control",)),
    Fault("autopilot-clock", ("attitudes", "time")),
    Fault("event-time-base", ("time",)),
    Fault("height-kind", ("positions",)),
)


def fault(code: str, table: tuple[Fault, ...] = FAULTS) -> Fault | None:
    """Give the entry of a code; None for a finding that is no fault of the table."""
    return next((entry for entry in table if entry.code == code), None)
