"""The lens of one ray: distortion and residual with their derivatives, for every camera model.

This is the only place that knows how the models differ; normal equations, residuals, statistics and
plots all call it. Coordinates are in the image plane, in the unit of the camera. Brown's polynomial stands
here. Another model is a function that projects points of camera axes, with its derivatives, in a file of its
own, a line in `_projected` and its entry in `camera.MODELS`; or it comes from an installed package, with one
file and one entry (`camera.LensModel`).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.compiled import allocating, compiled, inlined
from photocal.geometry.camera import AFFINITIES, AFFINITY_MATRICES, MM, MODELS, OWN, PARAMETERS, Camera
from photocal.geometry.other_lenses import equidistant, pix4d_fisheye, rational

Project = Callable[..., tuple[float, float]]
# Parameters of Brown's lens, and of all lenses; those of the shutter follow.
BROWN, COUNT = PARAMETERS.index("B2") + 1, PARAMETERS.index("readout")
# Positions in the parameter vector.
_C, _X0, _K1, _P1, _B1 = (PARAMETERS.index(name) for name in ("c", "x0", "K1", "P1", "B1"))
_CODE = {model: code for code, model in enumerate(MODELS)}
_IDEAL, _RATIONAL, _EQUIDISTANT = _CODE["brown-ideal"], _CODE["rational"], _CODE["equidistant"]
# Code of `brown-observed` with its polynomial at the measured coordinates, errors and all; the others follow
# those of Brown.
_AT_MEASURED, OTHERS = -1, _IDEAL + 1
_FOCUS, LINE = 11, 12
_ADDITIVE, _BEFORE, _AFTER = (AFFINITIES.index(name) for name in ("additive", "before", "after"))
# Steps towards the computed coordinates; the last one is shorter than this many principal distances, so that
# what is left is its square.
_STEPS, _SHORT = 8, 1e-7
# Newton's steps for a single place or direction; the square of the last one, in principal distances.
_MOST, _SOLVED = 50, 1e-24


def optics(camera: Camera) -> Floats:
    """What a kernel must know of a camera beside its parameters.

    returns (14,): code of the model, code of the affinity's place, R0, the two affinity matrices row by row,
        the focus distance in mm, and by how much of the readout a line is later per unit of x and of y: 0, 0
        for a global shutter.
    """
    first, second = AFFINITY_MATRICES[camera.affinity_form]
    observed = camera.model == "brown-observed" and camera.distortion_at == "measured"
    code = _AT_MEASURED if observed else _CODE[camera.model]
    head = [code, AFFINITIES.index(camera.affinity), camera.reference_radius]
    return np.array(
        [*head, *np.ravel(first), *np.ravel(second), MM * camera.focus_m, *camera.line_slope()], dtype=float
    )


class Scratch(NamedTuple):
    """Where the derivatives of one ray are put; made once for many rays.

    by_image, by_point, by_camera (2, n): derivatives of the residual with respect to the image's own unknowns
        (exterior orientation, photo-variant parameters, movement during the readout), object point, and
        camera with movement.
    by_q (2, 3): with respect to the object point in camera axes.
    depth (1,): how far the point lies in front of the camera.
    slope (4,): d dx/dx, d dx/dy, d dy/dx, d dy/dy of the distortion.
    terms (2, 8): derivatives of the distortion with respect to K1..K4, P1..P4.
    """

    by_image: Floats
    by_point: Floats
    by_camera: Floats
    by_q: Floats
    depth: Floats
    slope: Floats
    terms: Floats


class Ray(NamedTuple):
    """One ray: its lens, where its image point is measured, and its object point.

    x, y: image coordinates in the image plane.
    u, v, w: object point in camera axes, m.
    """

    k: int
    x: float
    y: float
    u: float
    v: float
    w: float


def scratch(unknowns: int) -> Scratch:
    """Make room for the derivatives of one ray of an image with so many unknowns of its own."""
    return Scratch(
        np.zeros((2, unknowns)),
        np.zeros((2, 3)),
        np.zeros((2, len(OWN))),
        np.zeros((2, 3)),
        np.zeros(1),
        np.zeros(4),
        np.zeros((2, 8)),
    )


# Within kernels; called from outside them it would take a hundred times as long as the function itself.
kernel_scratch = allocating(scratch)


# Arrays are passed whole, with an index: a view for every ray would cost more than its arithmetic.
@inlined
def polynomial(
    cameras: Floats,
    k: int,
    reference_radius: float,
    g: float,
    x: float,
    y: float,
    slope: Floats,
    terms: Floats,
) -> tuple[float, float]:
    """Radial and decentering distortion at a point (Brown 1971).

    dx = x rad + (P1 (r^2 + 2 x^2) + 2 P2 x y) (1 + P3 r^2 + P4 r^4), dy likewise, with
    rad = K1 (r^2 - R0^2) + K2 (r^4 - R0^4) + K3 (r^6 - R0^6) + K4 (r^8 - R0^8).
    """
    k1, k2, k3, k4 = cameras[k, _K1], cameras[k, _K1 + 1], cameras[k, _K1 + 2], cameras[k, _K1 + 3]
    p1, p2, p3, p4 = cameras[k, _P1], cameras[k, _P1 + 1], cameras[k, _P1 + 2], cameras[k, _P1 + 3]
    s = reference_radius * reference_radius
    r2 = x * x + y * y
    q = g * g
    q2 = q * q
    q3, q4 = q2 * q, q2 * q2
    k1, k2, k3, k4 = q * k1, q2 * k2, q3 * k3, q4 * k4
    p1, p2 = g * p1, g * p2
    e1, e2 = r2 - s, r2 * r2 - s * s
    e3, e4 = r2 * r2 * r2 - s * s * s, r2 * r2 * r2 * r2 - s * s * s * s
    radial = k1 * e1 + k2 * e2 + k3 * e3 + k4 * e4
    radial_slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3 + r2 * 4.0 * k4)))
    swell = 1.0 + r2 * (p3 + r2 * p4)
    swell_slope = 2.0 * (p3 + 2.0 * p4 * r2)
    gx, gy, cross = r2 + 2.0 * x * x, r2 + 2.0 * y * y, 2.0 * x * y
    ax, ay = p1 * gx + p2 * cross, p2 * gy + p1 * cross
    mixed = 2.0 * (p1 * y + p2 * x) * swell
    slope[0] = radial + x * x * radial_slope + (6.0 * p1 * x + 2.0 * p2 * y) * swell + ax * swell_slope * x
    slope[1] = x * y * radial_slope + mixed + ax * swell_slope * y
    slope[2] = x * y * radial_slope + mixed + ay * swell_slope * x
    slope[3] = radial + y * y * radial_slope + (6.0 * p2 * y + 2.0 * p1 * x) * swell + ay * swell_slope * y
    e1, e2, e3, e4, lens = q * e1, q2 * e2, q3 * e3, q4 * e4, g * swell
    terms[0, 0], terms[0, 1], terms[0, 2], terms[0, 3] = x * e1, x * e2, x * e3, x * e4
    terms[1, 0], terms[1, 1], terms[1, 2], terms[1, 3] = y * e1, y * e2, y * e3, y * e4
    terms[0, 4], terms[0, 5], terms[0, 6], terms[0, 7] = gx * lens, cross * lens, ax * r2, ax * r2 * r2
    terms[1, 4], terms[1, 5], terms[1, 6], terms[1, 7] = cross * lens, gy * lens, ay * r2, ay * r2 * r2
    return x * radial + ax * swell, y * radial + ay * swell


def _chosen(code: int, project: Project, otherwise: Project) -> Project:
    """Choose one lens by its code, or what is chosen otherwise."""

    @inlined
    def chosen(
        optics: Floats, cameras: Floats, k: int, u: float, v: float, w: float, room: Scratch
    ) -> tuple[float, float]:
        """Project through it."""
        if optics[k, 0] == code:
            return project(cameras, k, u, v, w, room.by_q, room.by_camera, room.depth)
        return otherwise(optics, cameras, k, u, v, w, room)

    return chosen


@inlined
def _projected(
    optics: Floats, cameras: Floats, k: int, u: float, v: float, w: float, room: Scratch
) -> tuple[float, float]:
    """Project through a lens of ours that is not Brown's."""
    if optics[k, 0] == _RATIONAL:
        return rational(cameras, k, u, v, w, room.by_q, room.by_camera, room.depth)
    if optics[k, 0] == _EQUIDISTANT:
        return equidistant(cameras, k, u, v, w, room.by_q, room.by_camera, room.depth)
    return pix4d_fisheye(cameras, k, u, v, w, room.by_q, room.by_camera, room.depth)


# Those that packages bring stand before ours.
for _model, _lens in MODELS.items():
    if _lens.project is not None:
        _projected = _chosen(_CODE[_model], _lens.project, _projected)


@compiled
def other_residual(cameras: Floats, optics: Floats, ray: Ray, room: Scratch) -> tuple[float, float]:
    """Computed minus measured coordinates of a ray through a lens that is not Brown's, see `ray_residual`."""
    by_q, by_camera = room.by_q, room.by_camera
    k, x, y, u, v, w = ray
    sx, sy = _projected(optics, cameras, k, u, v, w, room)
    b1, b2 = cameras[k, _B1], cameras[k, _B1 + 1]
    m00 = 1.0 + b1 * optics[k, 3] + b2 * optics[k, 7]
    m01 = b1 * optics[k, 4] + b2 * optics[k, 8]
    m10 = b1 * optics[k, 5] + b2 * optics[k, 9]
    m11 = 1.0 + b1 * optics[k, 6] + b2 * optics[k, 10]
    for n in range(3):
        gx, gy = by_q[0, n], by_q[1, n]
        by_q[0, n], by_q[1, n] = m00 * gx + m01 * gy, m10 * gx + m11 * gy
    for n in range(COUNT):
        gx, gy = by_camera[0, n], by_camera[1, n]
        by_camera[0, n], by_camera[1, n] = m00 * gx + m01 * gy, m10 * gx + m11 * gy
    for n in range(2):
        by_camera[0, _X0 + n], by_camera[1, _X0 + n] = 1.0 - n, 1.0 * n
        at = 3 + 4 * n
        by_camera[0, _B1 + n] = optics[k, at] * sx + optics[k, at + 1] * sy
        by_camera[1, _B1 + n] = optics[k, at + 2] * sx + optics[k, at + 3] * sy
    return m00 * sx + m01 * sy + cameras[k, _X0] - x, m10 * sx + m11 * sy + cameras[k, _X0 + 1] - y


@inlined
def ray_residual(cameras: Floats, optics: Floats, ray: Ray, room: Scratch) -> tuple[float, float]:
    """What a ray misses Brown's model by, with derivatives: zero where (x, y) are the computed coordinates.

    cameras (cameras, 20): camera parameters.
    optics (cameras, 14): from `optics`.
    """
    k, x, y, u, v, w = ray
    by_q, by_camera, slope, terms = room.by_q, room.by_camera, room.slope, room.terms
    c, x0, y0, b1 = cameras[k, _C], cameras[k, _X0], cameras[k, _X0 + 1], cameras[k, _B1]
    b2 = cameras[k, _B1 + 1]
    place, r0 = optics[k, 1], optics[k, 2]
    f00, f01 = b1 * optics[k, 3] + b2 * optics[k, 7], b1 * optics[k, 4] + b2 * optics[k, 8]
    f10, f11 = b1 * optics[k, 5] + b2 * optics[k, 9], b1 * optics[k, 6] + b2 * optics[k, 10]
    ux, uy = -u / w, -v / w
    px, py = c * ux, c * uy
    bx, by = x - x0, y - y0
    focus = optics[k, _FOCUS]
    g = 1.0 if focus == 0.0 else (1.0 - c / focus) / (1.0 + c / (MM * w))
    # Each case sets: the residual (vx, vy); a: d/dp; z: d/d(x0, y0); m: what multiplies the polynomial's
    # terms; (sx, sy): the vector that the affinity acts on, t: what multiplies it.
    if optics[k, 0] != _IDEAL:
        a00, a01, a10, a11 = 1.0, 0.0, 0.0, 1.0
        if place == _BEFORE:
            sx, sy = bx, by
            ex, ey = bx + f00 * bx + f01 * by, by + f10 * bx + f11 * by
            dx, dy = polynomial(cameras, k, r0, g, ex, ey, slope, terms)
            vx, vy = px + dx - ex, py + dy - ey
            t00, t01, t10, t11 = slope[0] - 1.0, slope[1], slope[2], slope[3] - 1.0
            z00, z01 = -(t00 * (1.0 + f00) + t01 * f10), -(t00 * f01 + t01 * (1.0 + f11))
            z10, z11 = -(t10 * (1.0 + f00) + t11 * f10), -(t10 * f01 + t11 * (1.0 + f11))
            m00, m01, m10, m11 = 1.0, 0.0, 0.0, 1.0
        else:
            dx, dy = polynomial(cameras, k, r0, g, bx, by, slope, terms)
            if place == _ADDITIVE:
                sx, sy = bx, by
                vx, vy = px + dx + f00 * bx + f01 * by - bx, py + dy + f10 * bx + f11 * by - by
                t00, t01, t10, t11 = 1.0, 0.0, 0.0, 1.0
                z00, z01 = 1.0 - slope[0] - f00, -slope[1] - f01
                z10, z11 = -slope[2] - f10, 1.0 - slope[3] - f11
                m00, m01, m10, m11 = 1.0, 0.0, 0.0, 1.0
            else:
                sx, sy = bx - dx, by - dy
                vx, vy = px - sx - f00 * sx - f01 * sy, py - sy - f10 * sx - f11 * sy
                t00, t01, t10, t11 = -1.0, 0.0, 0.0, -1.0
                m00, m01, m10, m11 = 1.0 + f00, f01, f10, 1.0 + f11
                h00, h01, h10, h11 = 1.0 - slope[0], -slope[1], -slope[2], 1.0 - slope[3]
                z00, z01 = m00 * h00 + m01 * h10, m00 * h01 + m01 * h11
                z10, z11 = m10 * h00 + m11 * h10, m10 * h01 + m11 * h11
    else:
        dx, dy = polynomial(cameras, k, r0, g, px, py, slope, terms)
        z00, z01, z10, z11 = 1.0, 0.0, 0.0, 1.0
        m00, m01, m10, m11 = 1.0, 0.0, 0.0, 1.0
        t00, t01, t10, t11 = 1.0, 0.0, 0.0, 1.0
        if place == _ADDITIVE:
            sx, sy = px, py
            vx, vy = px + dx + f00 * px + f01 * py - bx, py + dy + f10 * px + f11 * py - by
            a00, a01, a10, a11 = 1.0 + slope[0] + f00, slope[1] + f01, slope[2] + f10, 1.0 + slope[3] + f11
        elif place == _BEFORE:
            sx, sy = bx, by
            vx, vy = px + dx - bx - f00 * bx - f01 * by, py + dy - by - f10 * bx - f11 * by
            a00, a01, a10, a11 = 1.0 + slope[0], slope[1], slope[2], 1.0 + slope[3]
            z00, z01, z10, z11 = 1.0 + f00, f01, f10, 1.0 + f11
            t00, t11 = -1.0, -1.0
        else:
            sx, sy = px + dx, py + dy
            vx, vy = sx + f00 * sx + f01 * sy - bx, sy + f10 * sx + f11 * sy - by
            m00, m01, m10, m11 = 1.0 + f00, f01, f10, 1.0 + f11
            h00, h01, h10, h11 = 1.0 + slope[0], slope[1], slope[2], 1.0 + slope[3]
            a00, a01 = m00 * h00 + m01 * h10, m00 * h01 + m01 * h11
            a10, a11 = m10 * h00 + m11 * h10, m10 * h01 + m11 * h11
    room.depth[0] = -w
    s = c / w
    by_q[0, 0], by_q[0, 1], by_q[0, 2] = -s * a00, -s * a01, -s * (a00 * ux + a01 * uy)
    by_q[1, 0], by_q[1, 1], by_q[1, 2] = -s * a10, -s * a11, -s * (a10 * ux + a11 * uy)
    by_camera[0, _C], by_camera[1, _C] = a00 * ux + a01 * uy, a10 * ux + a11 * uy
    by_camera[0, _X0], by_camera[0, _X0 + 1] = z00, z01
    by_camera[1, _X0], by_camera[1, _X0 + 1] = z10, z11
    for n in range(8):
        by_camera[0, _K1 + n] = m00 * terms[0, n] + m01 * terms[1, n]
        by_camera[1, _K1 + n] = m10 * terms[0, n] + m11 * terms[1, n]
    for n in range(2):
        gx = optics[k, 3 + 4 * n] * sx + optics[k, 4 + 4 * n] * sy
        gy = optics[k, 5 + 4 * n] * sx + optics[k, 6 + 4 * n] * sy
        by_camera[0, _B1 + n] = t00 * gx + t01 * gy
        by_camera[1, _B1 + n] = t10 * gx + t11 * gy
    if focus != 0.0:
        vary_with_distance(cameras, k, focus, g, w, room)
    return vx, vy


@inlined
def vary_with_distance(cameras: Floats, k: int, focus: float, g: float, w: float, room: Scratch) -> None:
    """Add what the distortion's dependence on c and on the object's distance gives to the derivatives."""
    # g = (1 - c/s) / (1 - c/s'), the ratio of the image scales at focus s and object distance s' = -w.
    by_q, by_camera = room.by_q, room.by_camera
    c, depth = cameras[k, _C], -MM * w
    near = 1.0 - c / depth
    by_c = (1.0 / depth - 1.0 / focus) / (near * near)
    by_w = MM * g / near * c / (depth * depth)
    for a in range(2):
        by_g = 0.0
        for n in range(4):
            by_g += 2.0 * (n + 1) * cameras[k, _K1 + n] * by_camera[a, _K1 + n]
        by_g += cameras[k, _P1] * by_camera[a, _P1] + cameras[k, _P1 + 1] * by_camera[a, _P1 + 1]
        by_camera[a, _C] += by_g / g * by_c
        by_q[a, 2] += by_g / g * by_w


@inlined
def image_residual(cameras: Floats, optics: Floats, ray: Ray, room: Scratch) -> tuple[float, float]:
    """Residual of one ray in the image, computed minus measured, and its derivatives.

    Where the model is evaluated at image coordinates, the computed ones are those that fulfil it: Newton
    from the measured ones. Least squares of these residuals is the Gauss-Helmert model, whose weight of a
    condition f(x) is (F Q F')^-1 with F = df/dx at the corrected coordinates (Foerstner and Wrobel 2016,
    section 4.8). Where they do not exist, as for the start values of a point far outside, the condition is
    linear. Of `OTHERS` it is `other_residual`. Parameters as in `ray_residual`, with (x, y) measured.
    """
    by_q, by_camera = room.by_q, room.by_camera
    k, x, y, u, v, w = ray
    vx, vy, steps = 0.0, 0.0, 0
    limit = (_SHORT * cameras[k, _C]) ** 2
    while True:
        fx, fy = ray_residual(cameras, optics, Ray(k, x + vx, y + vy, u, v, w), room)
        if optics[k, 0] == _AT_MEASURED or (optics[k, 0] == _IDEAL and optics[k, 1] != _BEFORE):
            return fx, fy
        z00, z01, z10 = by_camera[0, _X0], by_camera[0, _X0 + 1], by_camera[1, _X0]
        z11 = by_camera[1, _X0 + 1]
        determinant = z00 * z11 - z01 * z10
        if not determinant > 0.0:
            if steps == 0 or steps == _STEPS:
                return fx, fy
            vx, vy, steps = 0.0, 0.0, _STEPS
            continue
        m00, m01, m10, m11 = z11 / determinant, -z01 / determinant, -z10 / determinant, z00 / determinant
        sx, sy = m00 * fx + m01 * fy, m10 * fx + m11 * fy
        vx, vy, steps = vx + sx, vy + sy, steps + 1
        if steps > _STEPS or sx * sx + sy * sy < limit:
            break
        if steps == _STEPS:
            vx, vy = 0.0, 0.0
    for n in range(3):
        gx, gy = by_q[0, n], by_q[1, n]
        by_q[0, n], by_q[1, n] = m00 * gx + m01 * gy, m10 * gx + m11 * gy
    for n in range(BROWN):
        gx, gy = by_camera[0, n], by_camera[1, n]
        by_camera[0, n], by_camera[1, n] = m00 * gx + m01 * gy, m10 * gx + m11 * gy
    return vx, vy


@inlined
def recorded(
    cameras: Floats, optics: Floats, k: int, u: float, v: float, w: float, room: Scratch, place: Floats
) -> bool:
    """Find where a camera records a point of camera axes (u, v, w); False where it does not."""
    by_camera = room.by_camera
    c, x, y = cameras[k, _C], cameras[k, _X0], cameras[k, _X0 + 1]
    if w < 0.0:
        x, y = x - c * u / w, y - c * v / w
    elif optics[k, 0] < OTHERS:
        return False
    for _ in range(_MOST):
        if optics[k, 0] >= OTHERS:
            vx, vy = other_residual(cameras, optics, Ray(k, x, y, u, v, w), room)
        else:
            vx, vy = ray_residual(cameras, optics, Ray(k, x, y, u, v, w), room)
        # The residual depends on x - x0 only: its derivative to x is the negative one to x0.
        a, b, d, e = by_camera[0, 1], by_camera[0, 2], by_camera[1, 1], by_camera[1, 2]
        determinant = a * e - b * d
        sx, sy = (e * vx - b * vy) / determinant, (a * vy - d * vx) / determinant
        x, y = x + sx, y + sy
        if sx * sx + sy * sy < _SOLVED * c * c:
            place[0], place[1] = x, y
            return bool(determinant > 0.0 and room.depth[0] > 0.0)
    return False


@inlined
def direction(
    cameras: Floats, optics: Floats, k: int, angular: bool, x: float, y: float, room: Scratch, vector: Floats
) -> bool:
    """Find the direction in camera axes of what is recorded at (x, y); False where there is none.

    Newton in the plane of the angles off the axis for a lens that is a function of them, else in the plane
    of their tangents.
    """
    by_q = room.by_q
    c, focus = cameras[k, _C], optics[k, _FOCUS]
    far = 1.0 if focus == 0.0 else focus / MM
    e0, e1 = (x - cameras[k, _X0]) / c, (y - cameras[k, _X0 + 1]) / c
    for _ in range(_MOST):
        u, v, w = e0, e1, -1.0
        t00, t01, t11, w0, w1 = 1.0, 0.0, 1.0, 0.0, 0.0
        if angular:
            angle = np.sqrt(e0 * e0 + e1 * e1)
            sinc, cosine = np.sin(angle) / angle if angle > 0.0 else 1.0, np.cos(angle)
            u, v, w = sinc * e0, sinc * e1, -cosine
            share = (cosine - sinc) / (angle * angle) if angle > 1e-4 else -1.0 / 3.0
            t00, t01, t11 = sinc + share * e0 * e0, share * e0 * e1, sinc + share * e1 * e1
            w0, w1 = sinc * e0, sinc * e1
        if optics[k, 0] >= OTHERS:
            vx, vy = other_residual(cameras, optics, Ray(k, x, y, u, v, w), room)
        else:
            ray = Ray(k, x, y, far * u, far * v, far * w)
            vx, vy = ray_residual(cameras, optics, ray, room)
        a = far * (by_q[0, 0] * t00 + by_q[0, 1] * t01 + by_q[0, 2] * w0)
        b = far * (by_q[0, 0] * t01 + by_q[0, 1] * t11 + by_q[0, 2] * w1)
        d = far * (by_q[1, 0] * t00 + by_q[1, 1] * t01 + by_q[1, 2] * w0)
        e = far * (by_q[1, 0] * t01 + by_q[1, 1] * t11 + by_q[1, 2] * w1)
        determinant = a * e - b * d
        s0, s1 = (e * vx - b * vy) / determinant, (a * vy - d * vx) / determinant
        e0, e1 = e0 - s0, e1 - s1
        if s0 * s0 + s1 * s1 < _SOLVED:
            vector[0], vector[1] = u - t00 * s0 - t01 * s1, v - t01 * s0 - t11 * s1
            vector[2] = w - w0 * s0 - w1 * s1
            return bool(determinant > 0.0)
    return False


@allocating
def all_recorded(cameras: Floats, optics: Floats, k: int, q: Floats, plane: Floats) -> None:
    """Find where camera k records points, NaN where it does not."""
    room, place = kernel_scratch(0), np.zeros(2)
    for n in range(len(q)):
        seen = recorded(cameras, optics, k, q[n, 0], q[n, 1], q[n, 2], room, place)
        # One by one: for whole rows the compiler brings a check of shapes that takes it ten seconds.
        for a in range(2):
            plane[n, a] = place[a] if seen else np.nan


@allocating
def all_directions(cameras: Floats, optics: Floats, k: int, angular: bool, plane: Floats, q: Floats) -> None:
    """Find the directions in which camera k sees, NaN where there is none."""
    room, vector = kernel_scratch(0), np.zeros(3)
    for n in range(len(q)):
        seen = direction(cameras, optics, k, angular, plane[n, 0], plane[n, 1], room, vector)
        for a in range(3):
            q[n, a] = vector[a] if seen else np.nan
