"""How a camera turned while it was read, by the gyroscope whose record its pictures carry."""

import base64
import binascii
import html
import re
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre

from photocal.base.arrays import Floats
from photocal.geometry.camera import MOTION, SHAKE, SHAKE_DEGREES

# Records of Parrot's Sequoia: time, us; rates about its axes, rad/s; and what is not told.
_RECORD = np.dtype([("time", "<u8"), ("rate", "<f4", 3), ("rest", "<u4")])
_RECORDS = re.compile(r":IMUAngularVelocity=\"([^\"<>]{0,100000})\"")
# Its axes point ahead, to the right and down; those of the camera to the right, ahead and up.
_TO_CAMERA = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_FASTEST = 50.0


def recorded_turns(packet: str, offset_ns: float) -> Floats:
    """Read the record of a picture's XMP packet.

    offset_ns: by how much the first record is before the first line (the tag IMUTimeOffset).
    returns (n, 4): times since the first line was read, s, and rates about the axes of the camera, rad/s;
        empty where there is none that can be read.
    """
    match = _RECORDS.search(packet)
    try:
        octets = base64.b64decode(html.unescape(match.group(1) if match else ""))
        records = np.frombuffer(octets, _RECORD)
    except (binascii.Error, ValueError):
        return np.zeros((0, 4))
    rate = records["rate"].astype(float)
    step = np.diff(records["time"].astype(float))
    credible = (step > 0).all() and (np.abs(rate) < _FASTEST).all()
    if len(records) < 2 or not np.isfinite(offset_ns) or not credible:
        return np.zeros((0, 4))
    # What is recorded was so much earlier: as filters delay it. Found by adjusting four exposures of one
    # head: medians of the residuals of 2.2 px without a delay, 1.4 with 20 ms, 0.6 with 40 and 45, 0.8 with
    # 50. With other readouts another delay fits best: 0.66 px for 150 ms, 0.68 for 175.
    delay_s = 0.042
    elapsed = 1e-6 * np.r_[0.0, np.cumsum(step)] - 1e-9 * offset_ns - delay_s
    return np.column_stack([elapsed, rate @ _TO_CAMERA.T])


def motion_while_read(velocity: Floats, records: Sequence[Floats], readout: Floats) -> tuple[Floats, Floats]:
    """Motion of images while they were read and its sigmas, as `block.model.Images` has them.

    velocity (n, 3): m/s, NaN where not known.
    records: of each image, see `recorded_turns`.
    readout (n,): of its camera, s.
    """
    motion = np.full((len(velocity), len(MOTION + SHAKE)), np.nan)
    sigma = np.full((len(velocity), len(MOTION)), np.nan)
    motion[:, :3] = velocity
    # The bias of such a gyroscope, and what an uncertain delay does, rad/s.
    rate_sigma = 0.02
    for k, record in enumerate(records):
        if len(record) and readout[k] > 0:
            motion[k, 3:] = turns_while_read(record, readout[k])
            sigma[k, 3:] = rate_sigma
    shaken = np.isfinite(motion[:, len(MOTION) :]).any()
    return motion if shaken else motion[:, : len(MOTION)], sigma


def turns_while_read(record: Floats, readout: float) -> Floats:
    """Motion of an image by a record: its rate, then Legendre polynomials of the line from degree 2.

    returns (18,): rad/s, of what the camera sees, as `block.model.Images.motion` has them.
    """
    line = np.linspace(-0.5, 0.5, 101)
    elapsed = (line + 0.5) * readout
    rate = np.column_stack([np.interp(elapsed, record[:, 0], axis) for axis in record[:, 1:].T])
    step = np.diff(elapsed)[:, None]
    turn = np.vstack([np.zeros(3), np.cumsum((rate[1:] + rate[:-1]) / 2 * step, axis=0)])
    parts = legendre.legfit(2.0 * line, -turn, SHAKE_DEGREES[-1])
    # The pose takes the mean; P1 is twice the line.
    return np.asarray(np.concatenate([2.0 * parts[1], parts[2:].ravel()]) / readout)
