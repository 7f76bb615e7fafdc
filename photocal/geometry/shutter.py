"""A rolling shutter: every line of the image is recorded at its own time, and so at its own pose.

In the line at s, which runs from -1/2 to 1/2 over the readout, the projection centre has moved by s V and the
camera turned by s W from its pose at the middle of the readout. V and W are the movement during the whole
readout: the given velocity and rate times the readout time, and what the image departs from them.

Vibration turns the camera to and fro within the readout. The turn is then s W plus Legendre polynomials of
2 s from the second degree on, which the pose and W leave.
"""

from photocal.base.arrays import Floats
from photocal.base.compiled import compiled, inlined
from photocal.geometry.camera import PARAMETERS, SHAKE_DEGREES
from photocal.geometry.lens import BROWN, LINE, OTHERS, Ray, Scratch, image_residual, other_residual

# Positions of the readout time and of an image's movement among its parameters, and of the given velocity and
# rate among its optics.
READOUT, MOVE = PARAMETERS.index("readout"), len(PARAMETERS)
GIVEN = LINE + 2
SHAKEN, DEGREES = MOVE + 6, len(SHAKE_DEGREES)


@inlined
def shaken(lenses: Floats, k: int, first: int, s: float) -> tuple[float, float, float, float, float, float]:
    """Turn of the camera in a line beside s W, about its axes, and how fast it changes with s.

    first: column of the first polynomial.
    """
    z = 2.0 * s
    before, now, slope_before, slope = 1.0, z, 0.0, 1.0
    a0, a1, a2, b0, b1, b2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(DEGREES):
        before, now = now, ((2 * n + 3) * z * now - (n + 1) * before) / (n + 2)
        slope_before, slope = slope, slope_before + (2 * n + 3) * before
        at = first + 3 * n
        c0, c1, c2 = lenses[k, at], lenses[k, at + 1], lenses[k, at + 2]
        a0, a1, a2 = a0 + now * c0, a1 + now * c1, a2 + now * c2
        b0, b1, b2 = b0 + 2.0 * slope * c0, b1 + 2.0 * slope * c1, b2 + 2.0 * slope * c2
    return a0, a1, a2, b0, b1, b2


@inlined
def by_shake(by_camera: Floats, a: int, s: float, d0: float, d1: float, d2: float) -> None:
    """Derivatives with respect to the polynomials from that with respect to the turn."""
    before, now = 1.0, 2.0 * s
    for n in range(DEGREES):
        before, now = now, ((2 * n + 3) * 2.0 * s * now - (n + 1) * before) / (n + 2)
        at = SHAKEN + 3 * n
        by_camera[a, at], by_camera[a, at + 1], by_camera[a, at + 2] = now * d0, now * d1, now * d2


@compiled
def rolling_residual(
    lenses: Floats,
    optics: Floats,
    ray: Ray,
    rotation: Floats,
    i: int,
    room: Scratch,
) -> tuple[float, float, float, float, float]:
    """Residual of a ray whose line is that of its computed coordinates, and its derivatives.

    lenses (lenses, 26 or 41): parameters of the camera, then V (m, object axes) and W (rad, camera axes),
        and where images shake the coefficients of the polynomials.
    optics (lenses, 20 or 35): from `optics`, then the given velocity (m/s) and rate (rad/s), and what a
        gyroscope has recorded of the polynomials (rad/s).
    ray: with its object point in camera axes at the middle of the readout.
    rotation (images, 3, 3): from object to camera axes, of image i.
    returns: residual in x and y; the point in camera axes before the turn of its line, to which a small turn
        of the image applies.
    """
    by_q, by_camera = room.by_q, room.by_camera
    k, x, y, u, v, w = ray
    lx, ly = optics[k, LINE], optics[k, LINE + 1]
    m0, m1, m2 = lenses[k, MOVE], lenses[k, MOVE + 1], lenses[k, MOVE + 2]
    t0, t1, t2 = lenses[k, MOVE + 3], lenses[k, MOVE + 4], lenses[k, MOVE + 5]
    # V in camera axes.
    a0 = rotation[i, 0, 0] * m0 + rotation[i, 0, 1] * m1 + rotation[i, 0, 2] * m2
    a1 = rotation[i, 1, 0] * m0 + rotation[i, 1, 1] * m1 + rotation[i, 1, 2] * m2
    a2 = rotation[i, 2, 0] * m0 + rotation[i, 2, 1] * m1 + rotation[i, 2, 2] * m2
    shakes, b0, b1, b2 = lenses.shape[1] > SHAKEN, 0.0, 0.0, 0.0
    s, vx, vy, steps = lx * x + ly * y, 0.0, 0.0, 0
    while True:
        # q = exp([s W]x) (p - s V), by Rodrigues' formula with its series.
        r0, r1, r2 = s * t0, s * t1, s * t2
        if shakes:
            a3, a4, a5, b0, b1, b2 = shaken(lenses, k, SHAKEN, s)
            r0, r1, r2 = r0 + a3, r1 + a4, r2 + a5
        square = r0 * r0 + r1 * r1 + r2 * r2
        first = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
        second = 0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0))
        pu, pv, pw = u - s * a0, v - s * a1, w - s * a2
        c0, c1, c2 = r1 * pw - r2 * pv, r2 * pu - r0 * pw, r0 * pv - r1 * pu
        qu = pu + first * c0 + second * (r1 * c2 - r2 * c1)
        qv = pv + first * c1 + second * (r2 * c0 - r0 * c2)
        qw = pw + first * c2 + second * (r0 * c1 - r1 * c0)
        if optics[k, 0] >= OTHERS:
            ex, ey = other_residual(lenses, optics, Ray(k, x, y, qu, qv, qw), room)
        else:
            ex, ey = image_residual(lenses, optics, Ray(k, x, y, qu, qv, qw), room)
        steps += 1
        # Derivatives are those at a line that is still off by as much as images turn while it is found.
        if steps == (3 if shakes else 2):
            break
        vx, vy = ex, ey
        s = min(max(lx * (x + vx) + ly * (y + vy), -1.0), 1.0)
    # How fast the computed coordinates move with s: dq/ds = W x q - exp([s W]x) V, with W that of the line.
    if shakes:
        b0, b1, b2 = t0 + b0, t1 + b1, t2 + b2
        t0 = b0 + 0.5 * (r1 * b2 - r2 * b1)
        t1 = b1 + 0.5 * (r2 * b0 - r0 * b2)
        t2 = b2 + 0.5 * (r0 * b1 - r1 * b0)
    c0, c1, c2 = r1 * a2 - r2 * a1, r2 * a0 - r0 * a2, r0 * a1 - r1 * a0
    s0 = t1 * qw - t2 * qv - a0 - first * c0 - second * (r1 * c2 - r2 * c1)
    s1 = t2 * qu - t0 * qw - a1 - first * c1 - second * (r2 * c0 - r0 * c2)
    s2 = t0 * qv - t1 * qu - a2 - first * c2 - second * (r0 * c1 - r1 * c0)
    speed_x = by_q[0, 0] * s0 + by_q[0, 1] * s1 + by_q[0, 2] * s2
    speed_y = by_q[1, 0] * s0 + by_q[1, 1] * s1 + by_q[1, 2] * s2
    # Their own line follows them: (I - speed line')^-1 = I + speed line' / (1 - line' speed).
    share = 1.0 - lx * speed_x - ly * speed_y
    speed_x, speed_y = speed_x / share, speed_y / share
    along = lx * (ex - vx) + ly * (ey - vy)
    vx, vy = ex + speed_x * along, ey + speed_y * along
    for n in range(3):
        along = lx * by_q[0, n] + ly * by_q[1, n]
        by_q[0, n] += speed_x * along
        by_q[1, n] += speed_y * along
    for n in range(READOUT if optics[k, 0] >= OTHERS else BROWN):
        along = lx * by_camera[0, n] + ly * by_camera[1, n]
        by_camera[0, n] += speed_x * along
        by_camera[1, n] += speed_y * along
    for a in range(2):
        g0, g1, g2 = by_q[a, 0], by_q[a, 1], by_q[a, 2]
        # d = J' (q x g), with J the left Jacobian of s W by its series.
        d0, d1, d2 = qv * g2 - qw * g1, qw * g0 - qu * g2, qu * g1 - qv * g0
        e0, e1, e2 = r2 * d1 - r1 * d2, r0 * d2 - r2 * d0, r1 * d0 - r0 * d1
        f0, f1, f2 = r2 * e1 - r1 * e2, r0 * e2 - r2 * e0, r1 * e0 - r0 * e1
        third = 1.0 / 6.0 - square / 120.0
        d0, d1 = d0 + second * e0 + third * f0, d1 + second * e1 + third * f1
        d2 = d2 + second * e2 + third * f2
        # h = exp([s W]x)' g.
        c0, c1, c2 = g1 * r2 - g2 * r1, g2 * r0 - g0 * r2, g0 * r1 - g1 * r0
        h0 = g0 + first * c0 + second * (c1 * r2 - c2 * r1)
        h1 = g1 + first * c1 + second * (c2 * r0 - c0 * r2)
        h2 = g2 + first * c2 + second * (c0 * r1 - c1 * r0)
        by_q[a, 0], by_q[a, 1], by_q[a, 2] = h0, h1, h2
        for n in range(3):
            along = h0 * rotation[i, 0, n] + h1 * rotation[i, 1, n] + h2 * rotation[i, 2, n]
            by_camera[a, MOVE + n] = -s * along
        by_camera[a, MOVE + 3], by_camera[a, MOVE + 4], by_camera[a, MOVE + 5] = s * d0, s * d1, s * d2
        if shakes:
            by_shake(by_camera, a, s, d0, d1, d2)
        along = 0.0
        for n in range(optics.shape[1] - GIVEN):
            along += by_camera[a, MOVE + n] * optics[k, GIVEN + n]
        by_camera[a, READOUT] = along
    return vx, vy, pu, pv, pw
