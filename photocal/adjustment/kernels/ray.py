"""One ray, one point, one element: what every pass is made of."""

from photocal.adjustment.kernels.data import Design, Structure, Values, columns, plain
from photocal.base.arrays import Floats
from photocal.base.compiled import inlined
from photocal.geometry.lens import LINE, OTHERS, Ray, Scratch, image_residual, other_residual
from photocal.geometry.shutter import rolling_residual


@inlined
def ray_rows(design: Design, values: Values, r: int, i: int, j: int, room: Scratch) -> tuple[float, float]:
    """Residual of ray r from image i to point j; its derivatives are put into the scratch room."""
    points, centre, rotation, basis = values.points, values.centre, values.rotation, values.basis
    k = design.image_lens[i]
    dx, dy, dz = points[j, 0] - centre[i, 0], points[j, 1] - centre[i, 1], points[j, 2] - centre[i, 2]
    u = rotation[i, 0, 0] * dx + rotation[i, 0, 1] * dy + rotation[i, 0, 2] * dz
    v = rotation[i, 1, 0] * dx + rotation[i, 1, 1] * dy + rotation[i, 1, 2] * dz
    w = rotation[i, 2, 0] * dx + rotation[i, 2, 1] * dy + rotation[i, 2, 2] * dz
    lenses, optics = values.lenses, design.optics
    ray = Ray(k, design.plane[r, 0], design.plane[r, 1], u, v, w)
    # The commonest camera has the shortest way; the longest is that of one that may move while it reads.
    still = plain(design) or (optics[k, LINE] == 0.0 and optics[k, LINE + 1] == 0.0)
    if plain(design) or (still and optics[k, 0] < OTHERS):
        vx, vy = image_residual(lenses, optics, ray, room)
    elif still:
        vx, vy = other_residual(lenses, optics, ray, room)
    else:
        vx, vy, u, v, w = rolling_residual(lenses, optics, ray, rotation, i, room)
    by_q, by_image, by_point = room.by_q, room.by_image, room.by_point
    for a in range(2):
        g0, g1, g2 = by_q[a, 0], by_q[a, 1], by_q[a, 2]
        # A small turn t moves q by t x q.
        t0, t1, t2 = v * g2 - w * g1, w * g0 - u * g2, u * g1 - v * g0
        for n in range(3):
            turn = t0 * basis[i, 0, n] + t1 * basis[i, 1, n] + t2 * basis[i, 2, n]
            along = g0 * rotation[i, 0, n] + g1 * rotation[i, 1, n] + g2 * rotation[i, 2, n]
            by_image[a, n] = turn * design.pose_free[i, n]
            by_image[a, 3 + n] = -along * design.pose_free[i, 3 + n]
            by_point[a, n] = along * design.point_free[j, n]
        for n in range(columns(design) - 6):
            present = n < design.variant_count[k]
            by_image[a, 6 + n] = room.by_camera[a, design.variant[k, n]] if present else 0.0
    return vx, vy


@inlined
def inverse3(matrix: Floats, result: Floats, j: int) -> bool:
    """Invert a symmetric positive definite 3 x 3 matrix; False, and zeros, when it is singular."""
    a, b, c = matrix[0, 0], matrix[1, 1], matrix[2, 2]
    d, e, f = matrix[1, 0], matrix[2, 0], matrix[2, 1]
    c00, c10, c20 = b * c - f * f, e * f - d * c, d * f - b * e
    determinant = a * c00 + d * c10 + e * c20
    if not determinant > 1e-14 * a * b * c:
        result[j] = 0.0
        return False
    s = 1.0 / determinant
    result[j, 0, 0], result[j, 1, 1], result[j, 2, 2] = c00 * s, (a * c - e * e) * s, (a * b - d * d) * s
    result[j, 1, 0] = result[j, 0, 1] = c10 * s
    result[j, 2, 0] = result[j, 0, 2] = c20 * s
    result[j, 2, 1] = result[j, 1, 2] = (d * e - a * f) * s
    return True


@inlined
def corner_of(structure: Structure, column: int) -> tuple[int, int, int]:
    """Where a column's diagonal element and its first row of the border stand; from row to row."""
    home = column // structure.panel
    top = home * structure.panel
    step = structure.width[home]
    start = structure.offset[home] + column - top
    return start + (column - top) * step, start + (structure.last[home] - top) * step, step


@inlined
def element_address(structure: Structure, row: int, column: int) -> int:
    """Where an element of the lower triangle stands among the values of the reduced matrix."""
    band = structure.band
    if column >= band:
        return int(
            structure.offset[len(structure.width) - 1] + (row - band) * structure.border + column - band
        )
    corner, foot, step = corner_of(structure, column)
    return int(corner + (row - column) * step if row < band else foot + (row - band) * step)
