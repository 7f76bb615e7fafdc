"""Sections of a certificate about one camera: its facts, interior orientation, distortion and residuals."""

from __future__ import annotations

import numpy as np

from photocal.report.catalogue import Catalogue
from photocal.report.digits import fixed, measured, power_of_ten, significant, symbol, unit_power
from photocal.report.distortion import RADIAL, farthest_corner, radial_profile
from photocal.report.document import (
    Column,
    Figure,
    KeyValues,
    Paragraph,
    Piece,
    Section,
    Statement,
    Table,
)
from photocal.report.figures import correlation_picture, natural_width, radial_curve, residual_map
from photocal.report.run import CameraResult, Correlation, ImageRms, Run
from photocal.report.sensor import SensorResiduals, sensor_residuals, thinned

CONFIDENCE = 0.95
STRONG = 0.9
ROWS = 60
ARROWS = 1500

# The power of the image unit that each parameter carries.
POWERS = {
    "c": 1,
    "x0": 1,
    "y0": 1,
    "K1": -2,
    "K2": -4,
    "K3": -6,
    "K4": -8,
    "P1": -1,
    "P2": -1,
    "P3": -2,
    "P4": -4,
}
# Zero is a special value for these; that c differs from zero is no finding.
NOT_TESTED = ("c",)


def camera_facts(camera_id: str, camera: CameraResult, say: Catalogue) -> KeyValues:
    """List the format, pitch and model of a camera.

    Parameters
    ----------
    camera_id : str
        Its name within the block.
    camera : CameraResult
        The camera.
    say : Catalogue
        Language.

    Returns
    -------
    KeyValues
    """
    width, height = camera.size_px
    size = {"width": str(width), "height": str(height)}
    rows = [(say("camera.id"), camera_id)]
    if camera.unit == "mm" and camera.pitch_mm is not None:
        extent = [fixed(n * p, 3, say.mark) for n, p in zip(camera.size_px, camera.pitch_mm, strict=True)]
        rows.append((say("camera.format"), say("camera.format_mm", **size, x=extent[0], y=extent[1])))
        pitch = [significant(1e3 * p, 6, say.mark) for p in camera.pitch_mm]
        rows.append((say("camera.pitch"), say("camera.pitch_value", x=pitch[0], y=pitch[1])))
    else:
        rows.append((say("camera.format"), say("camera.format_value", **size)))
    rows.append((say("camera.unit"), camera.unit))
    rows.append((say("camera.model"), say(f"camera.model_{camera.model.removeprefix('brown-')}")))
    rows.append((say("camera.affinity"), _affinity(camera, say)))
    if camera.reference_radius:
        rows.append(
            (
                say("camera.reference_radius"),
                f"{significant(camera.reference_radius, 6, say.mark)} {camera.unit}",
            )
        )
    rows.append((say("camera.axes"), say("camera.axes_value")))
    return KeyValues(tuple(rows))


def _affinity(camera: CameraResult, say: Catalogue) -> str:
    used = any(camera.value(name) or name in camera.correlation.names for name in ("B1", "B2"))
    if not used:
        return say("camera.affinity_none")
    return say(
        "camera.affinity_value",
        form=say(f"camera.form_{camera.affinity_form}"),
        place=say(f"camera.affinity_{camera.affinity}"),
    )


def interior_orientation(title: str, camera: CameraResult, dof: int, say: Catalogue) -> Section:
    """Make the table of interior orientation parameters with standard deviations and significance.

    Parameters
    ----------
    title : str
        Title of the section.
    camera : CameraResult
        The camera.
    dof : int
        Degrees of freedom of the adjustment, for Student's distribution.
    say : Catalogue
        Language.

    Returns
    -------
    Section
    """
    critical = critical_t(dof)
    columns = (
        Column(say("iop.name"), align="left"),
        Column(say("iop.meaning"), align="left"),
        Column(say("iop.value")),
        Column(say("iop.sigma")),
        Column(say("iop.unit"), align="left"),
        Column(say("iop.t")),
        Column(say("iop.significant"), align="center"),
    )
    names = [name for name, p in camera.parameters.items() if p.estimated or p.value != 0.0]
    rows = tuple(_iop_row(name, camera, critical, say) for name in names)
    note = say("iop.note", critical=fixed(critical, 2, say.mark))
    pieces: list[Piece] = [Table(say("iop.table"), columns, rows, note)]
    weak = [symbol(name) for name in insignificant(camera, dof)]
    if weak:
        text = say("iop.insignificant", names=", ".join(weak))
        pieces.append(Statement("note", say("iop.insignificant_title"), text))
    return Section(title, tuple(pieces))


def critical_t(dof: int) -> float:
    """Two-sided 95 % point of Student's distribution."""
    from scipy import stats

    return float(stats.t.ppf((1.0 + CONFIDENCE) / 2.0, max(dof, 1)))


def insignificant(camera: CameraResult, dof: int) -> list[str]:
    """Name the estimated parameters that cannot be told from zero at 95 %."""
    critical = critical_t(dof)
    estimated = [(name, p) for name, p in camera.parameters.items() if p.estimated and name not in NOT_TESTED]
    return [name for name, p in estimated if p.sigma > 0.0 and abs(p.value) / p.sigma < critical]


def _iop_row(name: str, camera: CameraResult, critical: float, say: Catalogue) -> tuple[str, ...]:
    parameter = camera.parameters[name]
    printed = measured(parameter.value, parameter.sigma, say.mark)
    unit = power_of_ten(printed.exponent, unit_power(camera.unit, POWERS.get(name, 0)))
    head = (symbol(name), say(f"parameter.{name}"), printed.value)
    if not parameter.estimated:
        return (*head, say("word.held"), unit or "1", say("word.none"), say("word.none"))
    if name in NOT_TESTED or parameter.sigma == 0.0:
        return (*head, printed.sigma, unit, say("word.none"), say("word.none"))
    t = parameter.value / parameter.sigma
    verdict = say("word.yes") if abs(t) >= critical else say("word.no")
    return (*head, printed.sigma, unit or "1", fixed(t, 1, say.mark), verdict)


def correlations(title: str, name: str, camera: CameraResult, say: Catalogue) -> Section:
    """Make the correlation matrix as a table, a picture and a sentence.

    Parameters
    ----------
    title, name : str
        Title of the section; short name of the camera for the picture.
    camera : CameraResult
        The camera.
    say : Catalogue
        Language.

    Returns
    -------
    Section
    """
    correlation = camera.correlation
    heads = [symbol(n) for n in correlation.names]
    columns = (Column("", align="left"), *(Column(head) for head in heads))
    rows = tuple(
        (heads[i], *(fixed(row[j], 2, say.mark) if j <= i else "" for j in range(len(heads))))
        for i, row in enumerate(correlation.matrix)
    )
    svg = correlation_picture(correlation, say)
    picture = Figure(
        f"correlation-{name}",
        say("correlation.figure"),
        say("correlation.alternative"),
        svg,
        width=natural_width(svg),
    )
    return Section(
        title,
        (
            Table(say("correlation.table"), columns, rows, dense=len(heads) > 9),
            Paragraph(_strong(correlation, say)),
            picture,
        ),
    )


def _strong(correlation: Correlation, say: Catalogue) -> str:
    limit = fixed(STRONG, 1, say.mark)
    n = len(correlation.names)
    pairs = [(i, j) for i in range(n) for j in range(i) if abs(correlation.matrix[i][j]) > STRONG]
    if not pairs:
        return say("correlation.weak", limit=limit)
    pairs.sort(key=lambda ij: -abs(correlation.matrix[ij[0]][ij[1]]))
    texts = [
        say(
            "correlation.pair",
            a=symbol(correlation.names[j]),
            b=symbol(correlation.names[i]),
            r=fixed(correlation.matrix[i][j], 2, say.mark),
        )
        for i, j in pairs
    ]
    return say("correlation.strong", limit=limit, pairs=", ".join(texts))


def radial_distortion(title: str, name: str, run: Run, camera_id: str, say: Catalogue) -> Section:
    """Make the distortion curve and its table.

    Parameters
    ----------
    title, name : str
        Title of the section; short name of the camera for the picture.
    run : Run
        The adjustment.
    camera_id : str
        The camera.
    say : Catalogue
        Language.

    Returns
    -------
    Section
    """
    camera = run.result.cameras[camera_id]
    if not any(camera.value(key) or key in camera.correlation.names for key in RADIAL):
        return Section(title, (Paragraph(say("distortion.none")),))
    corner = farthest_corner(camera)
    place = sensor_residuals(run, camera_id).place - [camera.value("x0"), camera.value("y0")]
    outermost = float(np.hypot(*place.T).max()) if len(place) else 0.0
    curve = radial_profile(camera, np.linspace(0.0, corner, 241))
    factor, unit = (1e3, "µm") if camera.unit == "mm" else (1.0, "px")
    at = [
        f"{fixed(factor * float(v), 1, say.mark)} {unit}"
        for v in (curve.displacement[0], curve.displacement[-1])
    ]
    radius = fixed(corner, 2, say.mark)
    figure = Figure(
        f"radial-{name}",
        say("distortion.figure"),
        say("distortion.alternative", first=at[0], last=at[1], radius=radius, unit=camera.unit),
        radial_curve(camera, curve, outermost, say),
    )
    note = say("distortion.note", corner=radius, outermost=fixed(outermost, 2, say.mark), unit=camera.unit)
    return Section(title, (figure, _distortion_table(camera, corner, note, say)))


def _distortion_table(camera: CameraResult, corner: float, note: str, say: Catalogue) -> Table:
    step = _round_step(corner / 10)
    profile = radial_profile(camera, np.append(np.arange(0.0, corner, step), corner))
    millimetres = camera.unit == "mm"
    pitch = float(np.mean(camera.pitch))
    columns = [Column(say("distortion.radius"), camera.unit)]
    if millimetres:
        columns += [Column(say("distortion.displacement"), "µm"), Column(say("distortion.sigma"), "µm")]
    columns += [Column(say("distortion.displacement"), "px"), Column(say("distortion.sigma"), "px")]
    columns.append(Column(say("distortion.decentring"), "µm" if millimetres else "px"))
    rows = []
    for r, d, s, t in zip(
        profile.radius, profile.displacement, profile.sigma, profile.decentering, strict=True
    ):
        row = [fixed(float(r), 2 if millimetres else 0, say.mark)]
        if millimetres:
            row += [fixed(1e3 * float(d), 1, say.mark), fixed(1e3 * float(s), 1, say.mark)]
        row += [fixed(float(d) / pitch, 2, say.mark), fixed(float(s) / pitch, 2, say.mark)]
        row.append(fixed(1e3 * float(t), 1, say.mark) if millimetres else fixed(float(t), 2, say.mark))
        rows.append(tuple(row))
    return Table(say("distortion.table"), tuple(columns), tuple(rows), note)


def _round_step(step: float) -> float:
    power = 10.0 ** np.floor(np.log10(step))
    return float(power * next(m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= step * 0.95))


def image_residuals(title: str, name: str, run: Run, camera_id: str, say: Catalogue) -> Section:
    """Make the map of residuals on the sensor and their size by image.

    Parameters
    ----------
    title, name : str
        Title of the section; short name of the camera for the picture.
    run : Run
        The adjustment.
    camera_id : str
        The camera.
    say : Catalogue
        Language.

    Returns
    -------
    Section
    """
    camera = run.result.cameras[camera_id]
    residuals = sensor_residuals(run, camera_id)
    vectors = thinned(residuals, camera, ARROWS)
    rays = len(residuals.place)
    caption = say("residuals.figure", rays=rays)
    if len(vectors.place) < rays:
        caption = say("residuals.figure_cells", rays=rays, cells=len(vectors.place))
    x, y = (fixed(v, 3, say.mark) for v in rms_px(residuals))
    figure = Figure(
        f"residuals-{name}",
        caption,
        say("residuals.alternative", rays=rays, x=x, y=y),
        residual_map(camera, vectors, say),
    )
    pieces: list[Piece] = [figure]
    if rays:
        pieces.append(Paragraph(_largest(run, camera_id, residuals, say)))
    pieces.append(_rms_table(run, camera_id, residuals, say))
    return Section(title, tuple(pieces))


def rms_px(residuals: SensorResiduals) -> tuple[float, float]:
    """Root mean square of the residuals in x and y, px; 0 without rays."""
    if not len(residuals.place):
        return 0.0, 0.0
    x, y = np.sqrt(np.mean(residuals.residual_px**2, axis=0))
    return float(x), float(y)


def _largest(run: Run, camera_id: str, residuals: SensorResiduals, say: Catalogue) -> str:
    of = dict(zip(run.exposures.image, run.exposures.camera, strict=True))
    own = [i for i, image in enumerate(run.residuals.image) if of[image] == camera_id]
    length = np.hypot(*residuals.residual_px.T)
    w = np.nan_to_num(np.abs(run.residuals.standardised[own])).max(axis=1)
    longest, worst = own[int(length.argmax())], own[int(w.argmax())]
    return say(
        "residuals.largest",
        size=fixed(float(length.max()), 2, say.mark),
        point=run.residuals.point[longest],
        image=run.residuals.image[longest],
        w=fixed(float(w.max()), 1, say.mark),
        wpoint=run.residuals.point[worst],
        wimage=run.residuals.image[worst],
    )


def _rms_table(run: Run, camera_id: str, residuals: SensorResiduals, say: Catalogue) -> Table:
    camera = run.result.cameras[camera_id]
    of = dict(zip(run.exposures.image, run.exposures.camera, strict=True))
    own = [rms for rms in run.result.images.rms if of.get(rms.image) == camera_id]
    shown, caption = own, say("residuals.table")
    if len(own) > ROWS:
        shown = sorted(own, key=lambda rms: -max(rms.rms_x, rms.rms_y))[: ROWS // 3]
        caption = say("residuals.table_worst", shown=len(shown), n=len(own))
    micrometres = camera.unit == "mm"
    columns = [Column(say("residuals.image"), align="left"), Column(say("residuals.rays"))]
    for unit in ("px", "µm") if micrometres else ("px",):
        columns += [Column(say("residuals.rms_x"), unit), Column(say("residuals.rms_y"), unit)]
    pitch = (1.0, 1.0) if run.result.block.observation_unit == "px" else camera.pitch_mm or camera.pitch
    rows = [_rms_row(rms.image, rms.rays, _in_px(rms, pitch), camera, say) for rms in shown]
    rows.append(_rms_row(say("residuals.all"), len(residuals.place), rms_px(residuals), camera, say))
    return Table(caption, tuple(columns), tuple(rows))


def _in_px(rms: ImageRms, pitch: tuple[float, float]) -> tuple[float, float]:
    return rms.rms_x / pitch[0], rms.rms_y / pitch[1]


def _rms_row(
    image: str, rays: int, rms: tuple[float, float], camera: CameraResult, say: Catalogue
) -> tuple[str, ...]:
    row = [image, str(rays), *(fixed(v, 3, say.mark) for v in rms)]
    if camera.unit == "mm":
        row += [fixed(1e3 * v * p, 2, say.mark) for v, p in zip(rms, camera.pitch, strict=True)]
    return tuple(row)
