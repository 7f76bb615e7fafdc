"""Sections of a certificate about what a camera does to the image: radial distortion and residuals."""

from __future__ import annotations

import numpy as np

from photocal.findings.digits import fixed
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import Camera
from photocal.report.document import Figure, Paragraph, Piece, Section, Table, columns
from photocal.report.figures import radial_curve, residual_map
from photocal.report.sensor import (
    RADIAL,
    SensorResiduals,
    farthest_corner,
    radial_profile,
    sensor_residuals,
    thinned,
)
from photocal.report.stored_analysis import Run

ROWS = 60
ARROWS = 1500


def radial_distortion(title: str, name: str, run: Run, camera_id: str, say: Catalogue) -> Section:
    """Make the distortion curve and its table."""
    camera = run.result.cameras[camera_id]
    if not any(camera.value(key) or key in camera.free for key in RADIAL):
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


def _distortion_table(camera: Camera, corner: float, note: str, say: Catalogue) -> Table:
    step = _round_step(corner / 10)
    profile = radial_profile(camera, np.append(np.arange(0.0, corner, step), corner))
    millimetres = camera.unit == "mm"
    pitch = float(np.mean(camera.pitch))
    units = ("µm", "px") if millimetres else ("px",)
    heads = [f"radius [{camera.unit}]"]
    heads += [f"{key} [{unit}]" for unit in units for key in ("displacement", "sigma")]
    heads.append(f"decentring [{units[0]}]")
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
    return Table(say("distortion.table"), columns(say, "distortion", *heads), tuple(rows), note)


def _round_step(step: float) -> float:
    power = 10.0 ** np.floor(np.log10(step))
    return float(power * next(m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= step * 0.95))


def image_residuals(title: str, name: str, run: Run, camera_id: str, say: Catalogue) -> Section:
    """Make the map of residuals on the sensor and their size by image."""
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
    rays = run.result.residuals_of(camera_id)
    length = np.hypot(*residuals.residual_px.T)
    w = np.nan_to_num(np.abs(rays.standardised)).max(axis=1)
    longest, worst = int(length.argmax()), int(w.argmax())
    return say(
        "residuals.largest",
        size=fixed(float(length.max()), 2, say.mark),
        point=rays.point_names[rays.point[longest]],
        image=rays.image_names[rays.image[longest]],
        w=fixed(float(w.max()), 1, say.mark),
        wpoint=rays.point_names[rays.point[worst]],
        wimage=rays.image_names[rays.image[worst]],
    )


def _rms_table(run: Run, camera_id: str, residuals: SensorResiduals, say: Catalogue) -> Table:
    camera = run.result.cameras[camera_id]
    own = run.result.images_of(camera_id).tolist()
    count, rms = run.result.residuals.rms()
    rms = rms / ((1.0, 1.0) if run.result.block.observation_unit == "px" else camera.pitch)
    shown, caption = own, say("residuals.table")
    if len(own) > ROWS:
        shown = sorted(own, key=lambda i: -rms[i].max())[: ROWS // 3]
        caption = say("residuals.table_worst", shown=len(shown), n=len(own))
    micrometres = camera.unit == "mm"
    units = ("px", "µm") if micrometres else ("px",)
    heads = ["image<", "rays", *(f"{key} [{unit}]" for unit in units for key in ("rms_x", "rms_y"))]
    names = run.result.images.names
    rows = [_rms_row(names[i], int(count[i]), tuple(rms[i].tolist()), camera, say) for i in shown]
    rows.append(_rms_row(say("residuals.all"), len(residuals.place), rms_px(residuals), camera, say))
    return Table(caption, columns(say, "residuals", *heads), tuple(rows))


def _rms_row(
    image: str, rays: int, rms: tuple[float, ...], camera: Camera, say: Catalogue
) -> tuple[str, ...]:
    row = [image, str(rays), *(fixed(v, 3, say.mark) for v in rms)]
    if camera.unit == "mm":
        row += [fixed(1e3 * v * p, 2, say.mark) for v, p in zip(rms, camera.pitch, strict=True)]
    return tuple(row)
