"""A second adjustment to compare with: a few lines of dense linear algebra, slow and plain.

It shares nothing with the project but the description of the network: the camera equations are written
down again from their definition, derivatives are taken by complex steps, the normal matrix is full.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.legendre import legval
from numpy.typing import NDArray

from photocal.adjustment.network import Network
from photocal.geometry.camera import PARAMETERS, Camera

READOUT = PARAMETERS.index("readout")

Floats = NDArray[np.float64]
# Real numbers, or complex ones while a derivative is taken.
Numbers = NDArray[Any]


def rotation(omega: Any, phi: Any, kappa: Any) -> Numbers:
    """M = R3(kappa) R2(phi) R1(omega), factor by factor."""
    so, co, sp, cp, sk, ck = (
        np.sin(omega), np.cos(omega), np.sin(phi), np.cos(phi), np.sin(kappa), np.cos(kappa),
    )  # fmt: skip
    r1 = np.array([[1, 0, 0], [0, co, so], [0, -so, co]])
    r2 = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    r3 = np.array([[ck, sk, 0], [-sk, ck, 0], [0, 0, 1]])
    return np.asarray(r3 @ r2 @ r1)


def polynomial(values: Numbers, r0: float, x: Any, y: Any) -> tuple[Any, Any]:
    """Brown's polynomial at a point."""
    k1, k2, k3, k4, p1, p2, p3, p4 = values[3:11]
    r2 = x**2 + y**2
    radial = k1 * (r2 - r0**2) + k2 * (r2**2 - r0**4) + k3 * (r2**3 - r0**6) + k4 * (r2**4 - r0**8)
    more = 1 + p3 * r2 + p4 * r2**2
    return (
        x * radial + (p1 * (r2 + 2 * x**2) + 2 * p2 * x * y) * more,
        y * radial + (p2 * (r2 + 2 * y**2) + 2 * p1 * x * y) * more,
    )


def affinity(form: str, b1: Any, b2: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """What the affinity adds to a point."""
    return {
        "fraser": (b1 * x + b2 * y, 0 * x),
        "canon-elph": (b1 * x, b2 * x),
        "tank": (b1 * y, b2 * y),
    }[form]


def residual(own: Camera, values: Numbers, measured: Numbers, q: Numbers) -> tuple[Any, Any]:
    """Condition of points in camera axes and image coordinates, by the definition of each model."""
    c, x0, y0 = values[:3]
    b1, b2 = values[11:13]
    if own.focus_m:
        # Brown 1971: coefficients of r^(2n) vary with the power 2n of the scale, P with the first.
        g = (1 - c / (1000 * own.focus_m)) / (1 - c / (-1000 * q[2]))
        one = g**0
        k1, k2, k3, k4, p1, p2, p3, p4 = values[3:11]
        scaled = [k1 * g**2, k2 * g**4, k3 * g**6, k4 * g**8, p1 * g, p2 * g, p3 * one, p4 * one]
        values = np.array([c * one, x0 * one, y0 * one, *scaled, b1 * one, b2 * one])
    if own.model not in ("brown-observed", "brown-ideal"):
        ix, iy = seen_by_other(own.model, values, q)
        ax, ay = affinity(own.affinity_form, b1, b2, ix, iy)
        return ix + ax + x0 - measured[0], iy + ay + y0 - measured[1]
    r0, form = own.reference_radius, own.affinity_form
    px, py = -c * q[0] / q[2], -c * q[1] / q[2]
    x, y = measured[0] - x0, measured[1] - y0
    if own.affinity == "before":
        ax, ay = affinity(form, b1, b2, x, y)
        x, y = x + ax, y + ay
    if own.model == "brown-observed":
        dx, dy = polynomial(values, r0, x, y)
        if own.affinity == "additive":
            ax, ay = affinity(form, b1, b2, x, y)
            dx, dy = dx + ax, dy + ay
        cx, cy = x - dx, y - dy
        if own.affinity == "after":
            ax, ay = affinity(form, b1, b2, cx, cy)
            cx, cy = cx + ax, cy + ay
        return px - cx, py - cy
    dx, dy = polynomial(values, r0, px, py)
    if own.affinity == "additive":
        ax, ay = affinity(form, b1, b2, px, py)
        dx, dy = dx + ax, dy + ay
    ix, iy = px + dx, py + dy
    if own.affinity == "after":
        ax, ay = affinity(form, b1, b2, ix, iy)
        ix, iy = ix + ax, iy + ay
    return ix - x, iy - y


def seen_by_other(model: str, values: Numbers, q: Numbers) -> tuple[Any, Any]:
    """Projection of the models that are not Brown's: OpenCV's and Pix4D's, y up."""
    value = dict(zip(PARAMETERS, values, strict=True))
    c, k = value["c"], [value[f"K{n}"] for n in range(1, 7)]
    r = np.sqrt(q[0] ** 2 + q[1] ** 2)
    if model == "rational":
        x, y = -q[0] / q[2], -q[1] / q[2]
        r2 = x**2 + y**2
        over = 1 + k[0] * r2 + k[1] * r2**2 + k[2] * r2**3
        h = over / (1 + k[3] * r2 + k[4] * r2**2 + k[5] * r2**3)
        p1, p2 = value["P1"], value["P2"]
        return (
            c * (x * h + p1 * (r2 + 2 * x**2) + 2 * p2 * x * y + value["S1"] * r2 + value["S2"] * r2**2),
            c * (y * h + p2 * (r2 + 2 * y**2) + 2 * p1 * x * y + value["S3"] * r2 + value["S4"] * r2**2),
        )
    # Half the angle, for what lies beside the camera: tan(t / 2) = r / (|q| - w).
    angle = 2 * np.arctan(r / (np.sqrt(r**2 + q[2] ** 2) - q[2]))
    if model == "equidistant":
        far = c * (angle + k[0] * angle**3 + k[1] * angle**5 + k[2] * angle**7 + k[3] * angle**9)
    else:
        t = 2 / np.pi * angle
        far = c * np.pi / 2 * (t + k[0] * t**2 + k[1] * t**3 + k[2] * t**4)
    return far * q[0] / r, far * q[1] / r


def exponential(turn: Numbers) -> Numbers:
    """Rotation matrices of rotation vectors (..., 3), by their series; the turns of mountings are small."""
    x, y, z = np.moveaxis(turn, -1, 0)
    skew = np.moveaxis(np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]]), (0, 1), (-2, -1))
    result = term = np.broadcast_to(np.eye(3, dtype=skew.dtype), skew.shape)
    for n in range(1, 25):
        term = term @ skew / n
        result = result + term
    return np.asarray(result)


def logarithm(matrix: Numbers) -> Numbers:
    """Rotation vector of a rotation by less than 90 degrees."""
    sine = (
        np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]) / 2
    )
    square = sine @ sine
    if abs(square) < 1e-12:
        return np.asarray(sine * (1 + square / 6))
    length = np.sqrt(square)
    return np.asarray(sine * np.arcsin(length) / length)


@dataclass(frozen=True)
class Result:
    """Values, covariance by the names of the unknowns; redundancy and design by image coordinates."""

    cameras: Floats
    exposures: Floats
    points: Floats
    common: Floats
    deviations: Floats
    covariance: Floats
    column: dict[tuple[str, int, int], int]
    residuals: Floats
    redundancy: Floats
    design: Floats
    chi_squared: float
    observations: int
    total_redundancy: float

    def block(self, kind: str, index: int, size: int) -> Floats:
        """Covariance of one camera, exposure or point; zeros where a value is held."""
        result = np.zeros((size, size))
        columns = [self.column.get((kind, index, n), -1) for n in range(size)]
        for a, ca in enumerate(columns):
            for b, cb in enumerate(columns):
                if ca >= 0 and cb >= 0:
                    result[a, b] = self.covariance[ca, cb]
        return result


def _columns(network: Network) -> dict[tuple[str, int, int], int]:
    names: list[tuple[str, int, int]] = []
    for k, own in enumerate(network.cameras):
        names += [("camera", k, n) for n in range(len(PARAMETERS)) if own.estimated[n]]
    sigma = network.exposures.sigma
    names += [("exposure", i, n) for i in range(len(sigma)) for n in range(6) if sigma[i, n] != 0]
    names += [("deviation", int(i), int(n)) for i, n in zip(*np.nonzero(_own_sigma(network)), strict=True)]
    held = network.points.held
    names += [("point", j, n) for j in range(len(held)) for n in range(3) if not held[j, n]]
    if len(network.positions.image) or len(network.attitudes.image):
        names += [("common", 0, int(n)) for n in np.flatnonzero(network.mounting.sigma)]
    mounted, shared = len(network.mounting.values), network.lasers.common_sigma
    names += [("common", 0, mounted + n) for n in range(len(shared)) if shared[n] != 0]
    return {name: at for at, name in enumerate(names)}


def _start(network: Network) -> dict[str, Floats]:
    return {
        "camera": np.array([own.values for own in network.cameras]),
        "exposure": network.exposures.values,
        "point": network.points.values,
        "common": np.append(network.mounting.values, np.zeros(len(network.lasers.common_sigma)))[None],
        "deviation": np.zeros((len(network.exposures.values), len(PARAMETERS) + 6 + 15)),
    }


def _own_sigma(network: Network) -> Floats:
    """By how much the parameters of each image deviate, then 6 movements and 15 shakes while it is read."""
    rows = []
    for i, k in enumerate(network.exposures.camera):
        own, motion = network.cameras[k], network.exposures.motion_sigma
        move = (
            np.zeros(6) if motion is None or not own.values[READOUT] else motion[i] * abs(own.values[READOUT])
        )
        shake = np.array(own.shake or [0.0] * 6)
        move = np.hypot(move, [0.0] * 3 + [shake[0]] * 3)
        rows.append(np.concatenate([own.deviation_sigma, move, np.repeat(shake[1:], 3)]))
    return np.array(rows)


def _values(network: Network, column: dict[tuple[str, int, int], int], x: Numbers) -> dict[str, Numbers]:
    values: dict[str, Numbers] = {kind: v.astype(x.dtype) for kind, v in _start(network).items()}
    for (kind, index, n), at in column.items():
        values[kind][index, n] = x[at]
    return values


@dataclass(frozen=True)
class Helmert:
    """Linear conditions f(place) + by_place (x - place) of the rays, and the roots of their weights."""

    place: Floats
    by_place: Floats
    root: Floats


def _helmert(network: Network, values: dict[str, Numbers], place: Floats) -> Helmert:
    """Conditions at corrected coordinates (Foerstner and Wrobel 2016, section 4.8)."""
    rays = network.rays
    at_measured = np.array([own.distortion_at == "measured" for own in network.cameras])
    old = at_measured[network.exposures.camera[rays.image]]
    place = np.where(old[:, None], rays.plane, place)
    by_place = np.empty((len(place), 2, 2))
    for n in range(2):
        moved = place.astype(complex)
        moved[:, n] += 1e-30j
        by_place[:, :, n] = _conditions(network, values, moved).imag / 1e-30
    by_place[old] = -np.eye(2)
    covariance = np.einsum("nab,nb,ncb->nac", by_place, rays.sigma**2, by_place)
    return Helmert(place, by_place, np.linalg.inv(np.linalg.cholesky(covariance)))


def _conditions(network: Network, values: dict[str, Numbers], place: Numbers) -> Numbers:
    rays = network.rays
    matrices = np.array([rotation(*pose[:3]) for pose in values["exposure"]])
    away = values["point"][rays.point] - values["exposure"][rays.image, 3:]
    q = np.einsum("nij,nj->in", matrices[rays.image], away)
    seen = np.empty((len(rays.image), 2), dtype=np.result_type(q, place))
    for i, k in enumerate(network.exposures.camera):
        own, mine = network.cameras[k], np.flatnonzero(rays.image == i)
        lens, there = values["camera"][k] + values["deviation"][i, : len(PARAMETERS)], q[:, mine]
        if own.estimated[READOUT] or own.values[READOUT]:
            there = _rolled(network, values, matrices[i], int(i), place[mine], there)
        seen[mine] = np.column_stack(residual(own, lens, place[mine].T, there))
    return seen


def _rolled(
    network: Network, values: dict[str, Numbers], matrix: Numbers, i: int, place: Numbers, q: Numbers
) -> Numbers:
    """Points in the camera axes that their line has: moved and turned from those at the middle."""
    own = network.cameras[network.exposures.camera[i]]
    width, height = np.array(own.size_px) * own.pitch
    later = {
        "top-to-bottom": -place[:, 1] / height,
        "bottom-to-top": place[:, 1] / height,
        "left-to-right": place[:, 0] / width,
        "right-to-left": -place[:, 0] / width,
    }[own.readout_direction]
    given = network.exposures.motion
    own_move = values["deviation"][i, len(PARAMETERS) :]
    move, shake = own_move[:6], np.vstack([np.zeros((2, 3)), own_move[6:].reshape(5, 3)])
    if given is not None:
        move = move + given[i] * values["camera"][network.exposures.camera[i], READOUT]
    share = later[:, None]
    turn = share * move[3:] + legval(2 * later, shake).T
    return np.asarray(np.einsum("nij,nj->in", exponential(turn), q.T - share * (matrix @ move[:3])))


def _residuals(network: Network, values: dict[str, Numbers], helmert: Helmert) -> Numbers:
    """All whitened residuals: rays, then points, cameras and exposures as observations."""
    matrices = np.array([rotation(*pose[:3]) for pose in values["exposure"]])
    seen = _conditions(network, values, helmert.place)
    seen = seen + np.einsum("nab,nb->na", helmert.by_place, network.rays.plane - helmert.place)
    out = list(np.einsum("nab,nb->na", helmert.root, seen).ravel())
    for j, weight in enumerate(network.points.weight):
        known = np.flatnonzero(np.diag(weight))
        if len(known):
            root = np.linalg.cholesky(weight[np.ix_(known, known)]).T
            out += list(root @ (values["point"][j] - network.points.values[j])[known])
    for k, own in enumerate(network.cameras):
        for n in np.flatnonzero(own.estimated & np.isfinite(own.prior_sigma)):
            out.append((values["camera"][k, n] - own.values[n]) / own.prior_sigma[n])
    by = _own_sigma(network)
    for i, n in zip(*np.nonzero(np.isfinite(by) & (by > 0)), strict=True):
        out.append(values["deviation"][i, n] / by[i, n])
    sigma = network.exposures.sigma
    for i, n in zip(*np.nonzero(np.isfinite(sigma) & (sigma > 0)), strict=True):
        out.append((values["exposure"][i, n] - network.exposures.values[i, n]) / sigma[i, n])
    out += _relations(network, values) + _lasers(network, values, matrices)
    return np.array(out + _navigation(network, values, matrices))


def _lasers(network: Network, values: dict[str, Numbers], matrices: Numbers) -> list[Any]:
    """Where the axis of a camera meets the plane of three points, in the object space."""
    out, lasers = [], network.lasers
    shared = values["common"][0, len(network.mounting.values) :]
    for i, corners, value, sigma in zip(
        lasers.image, lasers.corners, lasers.values, lasers.sigma, strict=True
    ):
        a, b, c = (values["point"][j] for j in corners)
        upright = np.cross(b - a, c - a)
        axis, centre = -matrices[i][2], values["exposure"][i, 3:]
        far = (upright @ (a - centre)) / (upright @ axis)
        out.append(((1 + shared[1]) * far + shared[0] - value) / sigma)
    for value, sigma in zip(shared, lasers.common_sigma, strict=True):
        if np.isfinite(sigma) and sigma > 0:
            out.append(value / sigma)
    return out


def _relations(network: Network, values: dict[str, Numbers]) -> list[Any]:
    out = []
    r = network.relations
    for kind, ends, value, sigma in zip(r.kind, r.ends, r.values, r.sigma, strict=True):
        a, b, c = (values["point"][j] for j in ends)
        d, e = b - a, c - a
        if kind == 5:
            # Across the line about constant axes: only what a point moves across it counts.
            real = np.real(d)
            first = np.cross(real, [0.3, 0.5, -0.8])
            axes = np.array([first, np.cross(real, first)])
            axes /= np.linalg.norm(axes, axis=1)[:, None]
            out += list(axes @ (e - d * (e @ d) / (d @ d)) / sigma)
            continue
        # The arc tangent of two complex numbers, by the angle that is left from the observed direction.
        turn = {3: (d[2], np.sqrt(d[0] ** 2 + d[1] ** 2)), 4: (e[0] * d[1] - e[1] * d[0], e[:2] @ d[:2])}
        x, y = turn.get(int(kind), (d[0], d[1]))
        left = np.arctan((x * np.cos(value) - y * np.sin(value)) / (x * np.sin(value) + y * np.cos(value)))
        out.append((np.sqrt(d @ d) - value, d[2] - value, left, left, left)[kind] / sigma)
    return out


def _navigation(network: Network, values: dict[str, Numbers], matrices: Numbers) -> list[Any]:
    """Antenna X0 + M'Bl - v dt + f + g h z + s + d t; attitude M = exp([r]x) B R with r in camera axes."""
    out: list[Any] = []
    common = values["common"][0]
    camera_of_body = exponential(common[3:6]) @ network.mounting.rotation
    p = network.positions
    for i, place, q, velocity, strip, time, above in zip(
        p.image, p.values, p.covariance, p.velocity, p.strip, p.time, p.above, strict=True
    ):
        own = common[11 + 6 * strip : 17 + 6 * strip]
        antenna = values["exposure"][i, 3:] + matrices[i].T @ camera_of_body @ common[:3]
        antenna = antenna - velocity * common[6] + own[:3] + own[3:] * time
        antenna = antenna + common[7:10] + above * np.array([0.0, 0.0, 1.0]) * common[10]
        out += list(np.linalg.cholesky(np.linalg.inv(q)).T @ (antenna - place))
    a = network.attitudes
    for i, body, q in zip(a.image, a.rotation, a.covariance, strict=True):
        turn = camera_of_body.T @ logarithm(matrices[i] @ (camera_of_body @ body).T)
        out += list(np.linalg.cholesky(np.linalg.inv(q)).T @ turn)
    if len(p.image) or len(a.image):
        m = network.mounting
        for n in np.flatnonzero(np.isfinite(m.sigma) & (m.sigma > 0)):
            out.append((common[n] - m.values[n]) / m.sigma[n])
    return out


def adjust_densely(network: Network, iterations: int = 40, defect: int = 0) -> Result:
    """Gauss-Newton on the whole system; derivatives by complex steps, exact to the last digit.

    With a datum defect the datum points move least from their start values: the null vectors of the design,
    restricted to their coordinates, are constraints of a bordered system.
    """
    column = _columns(network)
    start = _start(network)
    begin = x = np.array([start[kind][index, n] for kind, index, n in column])
    step = np.full(len(x), np.inf)
    place, rays = network.rays.plane, 2 * len(network.rays.image)
    apart = _apart(network, column, x)
    for _ in range(iterations):
        helmert = _helmert(network, _values(network, column, x), place)
        v = _residuals(network, _values(network, column, x), helmert)
        design = _jacobian(network, column, x, helmert, apart)
        # Corrections of the measured coordinates, v = -Q B' M^-1 w, from whitened conditions.
        back = -np.einsum("nb,nab,nca->nbc", network.rays.sigma**2, helmert.by_place, helmert.root)
        border = _constraints(network, column, design, defect)
        normal = np.block([[design.T @ design, border], [border.T, np.zeros((defect, defect))]])
        scale = np.sqrt(np.maximum(np.abs(normal).max(axis=0), 1e-300))
        whole = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
        inverse = np.asarray(whole[: len(x), : len(x)], dtype=np.float64)
        if np.abs(step / np.sqrt(np.diag(inverse))).max() < 1e-8:
            break
        right = np.concatenate([design.T @ v, border.T @ (x - begin)])
        step = -(whole @ right)[: len(x)]
        x = x + step
        left = (v + design @ step)[:rays].reshape(-1, 2)
        place = network.rays.plane + np.einsum("nbc,nc->nb", back, left)
    else:
        raise AssertionError("the comparison adjustment does not converge")
    values = _values(network, column, x)
    # By changes of the image coordinates: with M = L L', the rows -B^-1 L have the covariance Q.
    to_image = -np.linalg.inv(helmert.by_place) @ np.linalg.inv(helmert.root) / network.rays.sigma[:, :, None]
    design[:rays] = (to_image @ design[:rays].reshape(-1, 2, len(x))).reshape(rays, len(x))
    redundancy = 1.0 - np.einsum("na,ab,nb->n", design, inverse, design)
    return Result(
        values["camera"],
        values["exposure"],
        values["point"],
        values["common"][0],
        values["deviation"],
        inverse,
        column,
        np.einsum("nbc,nc->nb", back, v[:rays].reshape(-1, 2)),
        redundancy[:rays].reshape(-1, 2),
        design,
        float(v @ v),
        len(v),
        float(redundancy.sum()),
    )


def _constraints(
    network: Network, column: dict[tuple[str, int, int], int], design: Floats, defect: int
) -> Floats:
    """Null vectors of the design at the coordinates of the datum points, shape (unknowns, defect)."""
    length = np.linalg.norm(design, axis=0)
    _, singular, rows = np.linalg.svd(design / length)
    assert (singular < 1e-9 * singular[0]).sum() == defect
    null = rows[len(rows) - defect :].T / length[:, None]
    chosen = network.datum_points
    points = set(range(len(network.points.values)) if chosen is None or not len(chosen) else chosen.tolist())
    datum = np.array([kind == "point" and index in points for kind, index, _ in column])
    return np.asarray(np.where(datum[:, None], null, 0.0) / max(np.abs(null).max(initial=0.0), 1e-300))


@dataclass(frozen=True)
class Apart:
    """Unknowns that no observation has together: one complex step tells the derivatives of a whole group.

    groups: columns of each group. touched (observations, unknowns): where a derivative may be.
    """

    groups: list[NDArray[np.int64]]
    touched: NDArray[np.bool_]


def _apart(network: Network, column: dict[tuple[str, int, int], int], x: Floats) -> Apart:
    """Group unknowns by what they touch a little beside their values, where no derivative is just zero."""
    rng = np.random.default_rng(1)
    x = x * (1 + 1e-6 * rng.uniform(-1, 1, len(x))) + 1e-9 * rng.uniform(-1, 1, len(x))
    helmert = _helmert(network, _values(network, column, x), network.rays.plane)
    alone = Apart([np.array([n]) for n in range(len(x))], np.ones((1, len(x)), dtype=np.bool_))
    touched = _jacobian(network, column, x, helmert, alone) != 0
    together = touched.T.astype(np.float64) @ touched > 0
    groups: list[list[int]] = []
    for n in range(len(x)):
        free = next((group for group in groups if not together[n, group].any()), None)
        if free is None:
            groups.append([n])
        else:
            free.append(n)
    return Apart([np.array(group) for group in groups], touched)


def _jacobian(
    network: Network, column: dict[tuple[str, int, int], int], x: Floats, helmert: Helmert, apart: Apart
) -> Floats:
    def slope(direction: Floats) -> Floats:
        values = _values(network, column, x + 1e-30j * direction)
        return np.asarray(_residuals(network, values, helmert).imag / 1e-30)

    along = np.random.default_rng(2).uniform(0.5, 1.5, len(x))
    whole = slope(along)
    design, touched = np.zeros((len(whole), len(x))), np.broadcast_to(apart.touched, (len(whole), len(x)))
    for group in apart.groups:
        of_group = slope(np.isin(np.arange(len(x)), group).astype(np.float64))
        design[:, group] = np.where(touched[:, group], of_group[:, None], 0.0)
    assert np.abs(design @ along - whole).max() <= 1e-9 * np.abs(design).max()
    return design
