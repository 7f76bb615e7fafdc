"""UBX in the table of the receivers' protocols: what its messages tell."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frames import Batch, Wire
from drivers.receiver import Fixes, ReceiverProtocol, TimeMarks
from drivers.ubx import decode as ubx
from photocal.base.arrays import Floats, Integers

_PVT_FIXES = ("none", "dead_reckoning", "2d", "3d", "3d", "time_only")


class UbxProtocol(ReceiverProtocol):
    """u-blox receivers."""

    wire, name, converter = Wire.UBX, "UBX", "ubx"

    def kinds(self, data: bytes, start: Integers, length: Integers) -> Integers:  # noqa: ARG002
        """Return class and id of each frame."""
        octets = np.frombuffer(data, np.uint8)
        return octets[start + 2].astype(np.int64) << 8 | octets[start + 3]

    def kind_name(self, kind: int) -> str:
        """Return the name of the interface description."""
        return ubx.kind_name(kind)

    def fixes(self, batch: Batch) -> Mapping[str, Fixes]:
        """Return NAV-PVT, NAV-HPPOSLLH and NAV-POSLLH."""
        return {"NAV-PVT": _pvt(batch), "NAV-HPPOSLLH": _hpposllh(batch), "NAV-POSLLH": _posllh(batch)}

    def told_status(self) -> tuple[str, ...]:
        """Return the one that tells satellites and kind of fix."""
        return ("NAV-PVT",)

    def time_marks(self, batch: Batch) -> Mapping[str, TimeMarks]:
        """Return the edges of TIM-TM2."""
        messages = ubx.decode(batch, ubx.TIM_TM2)
        return {"TIM-TM2": ubx.time_marks(messages.fields).at(messages.index)}


def _pvt(batch: Batch) -> Fixes:
    messages = ubx.decode(batch, ubx.NAV_PVT)
    f = messages.fields
    carrier = f["flags"] >> 6
    fix = np.array([_PVT_FIXES[min(v, 5)] for v in f["fixType"].tolist()], "U16")
    fix[(f["flags"] & 2) != 0] = "differential"
    fix[carrier == 1] = "rtk_float"
    fix[carrier == 2] = "rtk_fixed"
    return Fixes.of(
        messages.index,
        **_place(f),
        satellites=f["numSV"].astype(np.int64),
        # JSON has no infinity: an age of 120 s or more is reported as 120 s.
        age_s=np.minimum(ubx.correction_age_s(f), 120.0),
        valid=(f["flags"] & 1) != 0,
        fix=fix,
    )


def _place(f: NDArray[Any]) -> dict[str, Floats]:
    """Position, claimed accuracy and undulation as NAV-PVT and NAV-POSLLH tell them."""
    return {
        "latitude_deg": f["lat"] * 1e-7,
        "longitude_deg": f["lon"] * 1e-7,
        "height_m": f["height"] * 1e-3,
        "horizontal_m": f["hAcc"] * 1e-3,
        "vertical_m": f["vAcc"] * 1e-3,
        "geoid_m": (f["height"].astype(float) - f["hMSL"]) * 1e-3,
    }


def _hpposllh(batch: Batch) -> Fixes:
    messages = ubx.decode(batch, ubx.NAV_HPPOSLLH)
    f = messages.fields
    return Fixes.of(
        messages.index,
        latitude_deg=f["lat"] * 1e-7 + f["_HPlat"] * 1e-9,
        longitude_deg=f["lon"] * 1e-7 + f["_HPlon"] * 1e-9,
        height_m=f["height"] * 1e-3 + f["_HPheight"] * 1e-4,
        horizontal_m=f["hAcc"] * 1e-4,
        vertical_m=f["vAcc"] * 1e-4,
        valid=(f["flags"] & 1) == 0,
    )


def _posllh(batch: Batch) -> Fixes:
    messages = ubx.decode(batch, ubx.NAV_POSLLH)
    return Fixes.of(messages.index, **_place(messages.fields))


PROTOCOL = UbxProtocol()
