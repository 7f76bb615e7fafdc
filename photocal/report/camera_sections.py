"""Sections of a certificate about one camera: its parameters, what it does to the image, residuals."""

import numpy as np
from scipy import special

from photocal.adjustment.readout import Readout
from photocal.analysis.robust import apart
from photocal.base.policy import policy
from photocal.findings.digits import power_of_ten, symbol, unit_power
from photocal.findings.document import (
    Column,
    KeyValues,
    Paragraph,
    PicturePart,
    Piece,
    Section,
    Statement,
    TablePart,
    said_table,
)
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import Camera
from photocal.report import sensor
from photocal.report.figures import correlation_picture, natural_width, radial_curve, residual_map
from photocal.report.stored_analysis import AnalysedRun

# Second opinions on standard deviations, see `analysis.robust`.
OPINIONS = ("jackknife", "sandwich", "bootstrap")
# Zero is a special value for these; that c differs from zero is no finding.
NOT_TESTED = ("c",)
# Longer tables show their worst rows, a third of so many.
ROWS = 60


def camera_facts(camera_id: str, camera: Camera, readout: Readout | None, say: Catalogue) -> KeyValues:
    """List the format, pitch and model of a camera."""
    width, height = camera.size_px
    form, pitch = {"width": str(width), "height": str(height)}, ""
    if camera.unit == "mm":
        x, y = (say.fixed(n * p, 3) for n, p in zip(camera.size_px, camera.pitch, strict=True))
        form |= {"x": x, "y": y}
        x, y = (say.significant(1e3 * p, 6) for p in camera.pitch)
        pitch = say("camera.pitch_value", x=x, y=y)
    affinity = say("camera.affinity_none")
    if any(camera.value(name) or name in camera.free for name in ("B1", "B2")):
        kinds = {"form": f"form_{camera.affinity_form}", "place": f"affinity_{camera.affinity}"}
        affinity = say("camera.affinity_value", **{name: say(f"camera.{key}") for name, key in kinds.items()})
    radius, focus = say.significant(camera.reference_radius, 6), say.significant(camera.focus_m, 4)
    facts = {
        "id": camera_id,
        "format": say("camera.format_mm" if pitch else "camera.format_value", **form),
        "pitch": pitch,
        "unit": camera.unit,
        "model": say(f"camera.model_{camera.model.removeprefix('brown-')}"),
        "affinity": affinity,
        "reference_radius": f"{radius} {camera.unit}" if camera.reference_radius else "",
        "focus": say("camera.focus_value", distance=f"{focus} m") if camera.focus_m else "",
        "photo_variant": ", ".join(camera.photo_variant),
        "shutter": "" if readout is None else _shutter(camera, readout, say),
        "axes": say("camera.axes_value"),
    }
    return KeyValues(tuple((say(f"camera.{key}"), text) for key, text in facts.items() if text))


def _shutter(camera: Camera, readout: Readout, say: Catalogue) -> str:
    """What was found of the readout, with its effect in the image and on the way flown."""
    readout_ms, sigma, exponent = say.measured(1e3 * readout.value, 1e3 * readout.sigma)
    text = say(
        "camera.shutter_rolling" if readout.estimated else "camera.shutter_global",
        readout=readout_ms,
        sigma=sigma,
        unit=power_of_ten(exponent, "ms"),
        effect=say.significant(readout.effect / camera.pitch[0], 2),
        way=say.significant(100 * readout.way, 2),
        p=say.significant(readout.p_value, 2),
    )
    shaken = say.significant(camera.shaken / camera.pitch[0], 2)
    return text + (say("camera.shutter_shakes", effect=shaken) if camera.shake else "")


def interior_orientation(title: str, camera_id: str, run: AnalysedRun, say: Catalogue) -> Section:
    """Make the table of interior orientation parameters with standard deviations and significance."""
    camera, factor = run.result.cameras[camera_id], run.result.scale
    critical = critical_t(run.result.degrees_of_freedom)
    opinions = _opinions(camera_id, run)
    told = [whose for whose in OPINIONS if any(of[whose] for of in opinions.values())]
    further = [*([] if factor is None else ["scaled"]), *told]
    heads = ("name<", "meaning<", "value", "sigma", *further, "unit<", "t", "significant=")
    rows = []
    for name in camera.used:
        sigma = camera.sigma_of(name)
        beside = {"scaled": (factor or 1.0) * sigma, **opinions.get(name, dict.fromkeys(OPINIONS))}
        largest = run.stated(camera_id, name)[0]
        rows.append(_iop_row(name, camera, critical, largest, [beside[key] for key in further], say))
    notes = [say("iop.note", critical=say.fixed(critical, 2)), *(say(f"iop.note_{whose}") for whose in told)]
    note = " ".join([*notes, say("iop.differs")] if told else notes)
    pieces: list[Piece] = [said_table(say, "iop.table", heads, rows, note)]
    weak = [symbol(name) for name in insignificant(camera_id, run)]
    if weak:
        text = say("iop.insignificant", names=", ".join(weak))
        pieces.append(Statement("note", say("iop.insignificant_title"), text))
    return Section(title, tuple(pieces))


def _opinions(camera_id: str, run: AnalysedRun) -> dict[str, dict[str, float | None]]:
    """Standard deviations by other means of the parameters for which one differs by more than a third."""
    record = run.analysis.jackknife.get(camera_id) if run.analysis else None
    if record is None:
        return {}
    camera, factor = run.result.cameras[camera_id], run.result.scale or 1.0
    of = {name: record.others(name) for name in camera.free}
    return {
        name: others
        for name, others in of.items()
        if any(apart(factor * camera.sigma_of(name), sigma) for sigma in others.values())
    }


def critical_t(dof: int) -> float:
    """Two-sided 95 % point of Student's distribution."""
    return float(special.stdtrit(max(dof, 1), (1.0 + policy.confidence) / 2.0))


def insignificant(camera_id: str, run: AnalysedRun) -> list[str]:
    """Name the estimated parameters that are not significant at 95 %, by the largest of their sigmas."""
    camera, critical = run.result.cameras[camera_id], critical_t(run.result.degrees_of_freedom)
    tested = [name for name in camera.free if name not in NOT_TESTED and camera.sigma_of(name) > 0.0]
    return [name for name in tested if abs(camera.value(name)) / run.stated(camera_id, name)[0] < critical]


def unit_of(camera: Camera, name: str, exponent: int) -> str:
    """Write the unit of a parameter that is printed without a power of ten."""
    unit = "s" if name == "readout" else unit_power(camera.unit, camera.lens.power(name))
    return power_of_ten(exponent, unit) or "1"


def _iop_row(
    name: str,
    camera: Camera,
    critical: float,
    largest: float,
    beside: list[float | None],
    say: Catalogue,
) -> tuple[str, ...]:
    value, sigma, none = camera.value(name), camera.sigma_of(name), say("word.none")
    printed, spread, exponent = say.measured(value, sigma)
    free = name in camera.free
    unit = unit_of(camera, name, exponent)
    others = (say.significant(s / 10.0**exponent, 2) if free and s else none for s in beside)
    head = (symbol(name), say(f"parameter.{name}"), printed)
    row = (*head, spread if free else say("word.held"), *others, unit)
    if not free or name in NOT_TESTED or sigma == 0.0:
        return (*row, none, none)
    t = value / largest
    return (*row, say.fixed(t, 1), say("word.yes" if abs(t) >= critical else "word.no"))


def correlations(title: str, name: str, camera: Camera, say: Catalogue) -> Section:
    """Make the correlation matrix as a table, a picture and a sentence."""
    heads = [symbol(n) for n in camera.free]
    correlation = camera.correlation_of(camera.free)
    shown = (Column("", align="left"), *map(Column, heads))
    rows = (
        (heads[i], *(say.fixed(row[j], 2) if j <= i else "" for j in range(len(heads))))
        for i, row in enumerate(correlation.tolist())
    )
    svg = correlation_picture(camera, say)
    texts = say("correlation.figure"), say("correlation.alternative")
    picture = PicturePart(f"correlation-{name}", *texts, svg, width=natural_width(svg))
    table = said_table(say, "correlation.table", shown, rows, dense=len(heads) > 9)
    return Section(title, (table, Paragraph(_strong(camera, say)), picture))


def _strong(camera: Camera, say: Catalogue) -> str:
    strong = 0.9
    limit = say.fixed(strong, 1)
    names, matrix = camera.free, camera.correlation_of(camera.free)
    pairs = [(i, j) for i in range(len(names)) for j in range(i) if abs(matrix[i, j]) > strong]
    if not pairs:
        return say("correlation.weak", limit=limit)
    pairs.sort(key=lambda ij: -abs(matrix[ij]))
    texts = [
        say("correlation.pair", a=symbol(names[j]), b=symbol(names[i]), r=say.fixed(float(matrix[i, j]), 2))
        for i, j in pairs
    ]
    return say("correlation.strong", limit=limit, pairs=", ".join(texts))


def radial_distortion(title: str, name: str, run: AnalysedRun, camera_id: str, say: Catalogue) -> Section:
    """Make the distortion curve and its table."""
    camera = run.result.cameras[camera_id]
    if not any(camera.value(key) or key in camera.free for key in sensor.RADIAL):
        return Section(title, (Paragraph(say("distortion.none")),))
    corner = sensor.farthest_corner(camera)
    place = sensor.sensor_residuals(run, camera_id).place - [camera.value("x0"), camera.value("y0")]
    outermost = float(np.hypot(*place.T).max()) if len(place) else 0.0
    curve = sensor.radial_profile(camera, np.linspace(0.0, corner, 241))
    factor, unit = (1e3, "µm") if camera.unit == "mm" else (1.0, "px")
    at = [f"{say.fixed(factor * float(v), 1)} {unit}" for v in curve[[0, -1], 1]]
    radius = say.fixed(corner, 2)
    figure = PicturePart(
        f"radial-{name}",
        say("distortion.figure"),
        say("distortion.alternative", first=at[0], last=at[1], radius=radius, unit=camera.unit),
        radial_curve(camera, curve, outermost, say),
    )
    note = say("distortion.note", corner=radius, outermost=say.fixed(outermost, 2), unit=camera.unit)
    return Section(title, (figure, _distortion_table(camera, corner, note, say)))


def _distortion_table(camera: Camera, corner: float, note: str, say: Catalogue) -> TablePart:
    power = float(10.0 ** np.floor(np.log10(corner / 10)))
    step = power * next(m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= corner / 10 * 0.95)
    profile = sensor.radial_profile(camera, np.append(np.arange(0.0, corner, step), corner))
    millimetres = camera.unit == "mm"
    pitch = float(np.mean(camera.pitch))
    units = ("µm", "px") if millimetres else ("px",)
    heads = [f"radius [{camera.unit}]"]
    heads += [f"{key} [{unit}]" for unit in units for key in ("displacement", "sigma")]
    heads.append(f"decentring [{units[0]}]")
    rows = []
    for r, d, s, t in profile.tolist():
        row = [say.fixed(r, 2 if millimetres else 0)]
        row += [say.fixed(1e3 * d, 1), say.fixed(1e3 * s, 1)] if millimetres else []
        row += [say.fixed(d / pitch, 2), say.fixed(s / pitch, 2)]
        row.append(say.fixed(1e3 * t, 1) if millimetres else say.fixed(t, 2))
        rows.append(tuple(row))
    return said_table(say, "distortion.table", heads, rows, note)


def image_residuals(title: str, name: str, run: AnalysedRun, camera_id: str, say: Catalogue) -> Section:
    """Make the map of residuals on the sensor and their size by image."""
    camera = run.result.cameras[camera_id]
    residuals = sensor.sensor_residuals(run, camera_id)
    # More arrows would cover each other.
    arrows = 1500
    vectors = sensor.thinned(residuals, camera, arrows)
    rays = len(residuals.place)
    caption = say("residuals.figure", rays=rays)
    if len(vectors.place) < rays:
        caption = say("residuals.figure_cells", rays=rays, cells=len(vectors.place))
    x, y = (say.fixed(v, 3) for v in rms_px(residuals))
    alternative = say("residuals.alternative", rays=rays, x=x, y=y)
    figure = PicturePart(f"residuals-{name}", caption, alternative, residual_map(camera, vectors, say))
    pieces: list[Piece] = [figure]
    if rays:
        pieces.append(Paragraph(_largest(run, camera_id, residuals, say)))
    pieces.append(_rms_table(run, camera_id, residuals, say))
    return Section(title, tuple(pieces))


def rms_px(residuals: sensor.SensorResiduals) -> tuple[float, float]:
    """Root mean square of the residuals in x and y, px; 0 without rays."""
    if not len(residuals.place):
        return 0.0, 0.0
    x, y = np.sqrt(np.mean(residuals.residual_px**2, axis=0))
    return float(x), float(y)


def _largest(run: AnalysedRun, camera_id: str, residuals: sensor.SensorResiduals, say: Catalogue) -> str:
    rays = run.result.residuals_of(camera_id)
    length = np.hypot(*residuals.residual_px.T)
    w = np.nan_to_num(np.abs(rays.standardised)).max(axis=1)
    longest, worst = int(length.argmax()), int(w.argmax())
    return say(
        "residuals.largest",
        size=say.fixed(float(length.max()), 2),
        point=rays.point_names[rays.point[longest]],
        image=rays.image_names[rays.image[longest]],
        w=say.fixed(float(w.max()), 1),
        wpoint=rays.point_names[rays.point[worst]],
        wimage=rays.image_names[rays.image[worst]],
    )


def _rms_table(
    run: AnalysedRun, camera_id: str, residuals: sensor.SensorResiduals, say: Catalogue
) -> TablePart:
    camera = run.result.cameras[camera_id]
    images = run.result.images_of(camera_id).tolist()
    count, rms = run.result.residuals.rms()
    rms = rms / ((1.0, 1.0) if run.result.block.observation_unit == "px" else camera.pitch)
    shown, which = images, "residuals.table"
    if len(images) > ROWS:
        shown = sorted(images, key=lambda i: -rms[i].max())[: ROWS // 3]
        which = "residuals.table_worst"
    micrometres = camera.unit == "mm"
    units = ("px", "µm") if micrometres else ("px",)
    heads = ["image<", "rays", *(f"{key} [{unit}]" for unit in units for key in ("rms_x", "rms_y"))]
    names = run.result.images.names
    rows = [_rms_row(names[i], int(count[i]), tuple(rms[i].tolist()), camera, say) for i in shown]
    rows.append(_rms_row(say("residuals.all"), len(residuals.place), rms_px(residuals), camera, say))
    return said_table(say, which, heads, rows, shown=len(shown), n=len(images))


def _rms_row(
    image: str, rays: int, rms: tuple[float, ...], camera: Camera, say: Catalogue
) -> tuple[str, ...]:
    row = [image, str(rays), *(say.fixed(v, 3) for v in rms)]
    if camera.unit == "mm":
        row += [say.fixed(1e3 * v * p, 2) for v, p in zip(rms, camera.pitch, strict=True)]
    return tuple(row)
