"""The run folder: the one writer and the one reader of a result."""

import json
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from photocal.base.arrays import Floats, Integers, as_plain
from photocal.base.checked_json import read_checked_json
from photocal.base.errors import InputMalformedError, InputNotFoundError
from photocal.base.files import write_json
from photocal.block.folder import IMAGE_SIGMAS
from photocal.block.model import fingerprint
from photocal.block.table import known_rows, read_table
from photocal.geometry.camera import (
    MOTION,
    PARAMETERS,
    SHAKE,
    Affinity,
    AffinityForm,
    Camera,
    DistortionAt,
    Model,
    ReadoutDirection,
    Shutter,
    camera,
)
from photocal.geometry.oriented_images import OrientedImages
from photocal.results.result import (
    ANGLES,
    PLACE,
    SHOWN,
    AdjustedHead,
    AdjustedPoints,
    Figures,
    Residuals,
    Result,
)

if TYPE_CHECKING:
    from pydantic import TypeAdapter

SCHEMA = "photocal.adjustment/1"
RESULT = "result.json"
COVARIANCE = "covariance.parquet"
AGAIN = "run `photocal adjust` again"
# Residual tables longer than this are written as Parquet.
LONG_TABLE = 500_000
LARGEST_JSON = 1 << 28

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class _Parameter:
    value: float
    sigma: float
    estimated: bool
    given: float | None = None
    prior_sigma: float | None = None
    deviation_sigma: float | None = None


@dataclass(frozen=True)
class _Correlation:
    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class _Camera:
    model: Model
    unit: Literal["mm", "px"]
    size_px: tuple[int, int]
    parameters: dict[str, _Parameter]
    correlation: _Correlation
    pitch_mm: tuple[float, float] | None = None
    reference_radius: float = 0.0
    affinity: Affinity = "additive"
    affinity_form: AffinityForm = "fraser"
    focus_m: float | None = None
    distortion_at: DistortionAt = "adjusted"
    shutter: Shutter = "global"
    readout_direction: ReadoutDirection = "top-to-bottom"
    shake_rad: tuple[float, ...] = ()
    c_is_a_guess: bool = False
    photo_variant: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Images:
    n: int


@dataclass(frozen=True, kw_only=True)
class _File(Figures):
    """What `result.json` holds."""

    schema: str
    cameras: dict[str, _Camera]
    images: _Images


def result_json(result: Result) -> dict[str, Any]:
    """Content of `result.json`."""
    plain = {field.name: as_plain(getattr(result, field.name)) for field in fields(Figures)}
    for optional in ("ellipses", "reliability", "control_residuals"):
        if plain[optional] is None:
            del plain[optional]
    count, rms = result.residuals.rms()
    rows = zip(result.images.names, count.tolist(), rms.tolist(), strict=True)
    return {
        "schema": SCHEMA,
        **plain,
        "cameras": {name: _camera_json(adjusted) for name, adjusted in result.cameras.items()},
        "images": {
            "n": len(result.images),
            "rms": [{"image": name, "rays": n, "rms_x": x, "rms_y": y} for name, n, (x, y) in rows],
        },
    }


def _camera_json(camera: Camera) -> dict[str, Any]:
    parameters = {}
    for name in camera.lens.names if camera.rolling else camera.lens.names[:-1]:
        k = PARAMETERS.index(name)
        prior, deviation = float(camera.prior_sigma[k]), float(camera.deviation_sigma[k])
        parameters[name] = {
            "value": float(camera.values[k]),
            "given": float((camera.values if camera.given is None else camera.given)[k]),
            "sigma": camera.sigma_of(name),
            "estimated": bool(camera.estimated[k]),
            "prior_sigma": prior if math.isfinite(prior) else None,
        }
        if deviation and math.isfinite(deviation):
            parameters[name]["deviation_sigma"] = deviation
    return {
        "model": camera.model,
        "unit": camera.unit,
        "size_px": list(camera.size_px),
        "pitch_mm": list(camera.pitch) if camera.unit == "mm" else None,
        "reference_radius": camera.reference_radius,
        "affinity": camera.affinity,
        "affinity_form": camera.affinity_form,
        "focus_m": camera.focus_m or None,
        "distortion_at": camera.distortion_at,
        "shutter": camera.shutter,
        "readout_direction": camera.readout_direction,
        "shake_rad": list(camera.shake),
        "c_is_a_guess": camera.guessed and not camera.estimated[0],
        "photo_variant": list(camera.photo_variant),
        "parameters": parameters,
        "correlation": {"names": list(camera.free), "matrix": camera.correlation_of(camera.free).tolist()},
    }


def write_result(folder: Path, result: Result) -> None:
    """Write `result.json` and the tables beside it into a folder that exists."""
    for name, table in result.tables().items():
        if name == "residuals" and table.num_rows > LONG_TABLE:
            pyarrow.parquet.write_table(table, folder / f"{name}.parquet")
        else:
            write_csv(folder / f"{name}.csv", table)
    pyarrow.parquet.write_table(_covariances(result), folder / COVARIANCE)
    write_json(folder / RESULT, result_json(result))


def write_csv(path: Path, table: Any) -> None:
    """Write an Arrow table as CSV; null cells are empty."""
    pyarrow.csv.write_csv(table, path, pyarrow.csv.WriteOptions(quoting_style="needed"))


def _covariances(result: Result) -> Any:
    """One row for each image (deg, m), point (m) and camera: its unknowns and the lower triangle by rows."""
    rows: list[tuple[str, Sequence[str], Sequence[str], Floats]] = [
        ("image", result.images.names, (*ANGLES, *PLACE), result.images.covariances * np.outer(SHOWN, SHOWN)),
        ("point", result.points.names, PLACE, result.points.covariance),
    ]
    for name, adjusted in result.cameras.items():
        rows.append(("camera", (name,), adjusted.free, adjusted.covariance_of(adjusted.free)[None]))
    rows += [("head", (head.camera,), head.free, head.covariance()[None]) for head in result.heads]
    lower = [m[:, *np.tril_indices(m.shape[1])] for _, _, _, m in rows]
    return pa.table(
        {
            "kind": [kind for kind, ids, _, _ in rows for _ in ids],
            "id": pa.array([name for _, ids, _, _ in rows for name in ids], pa.string()),
            "names": [list(names) for _, ids, names, _ in rows for _ in ids],
            "lower": pa.concat_arrays([_lists(part) for part in lower]),
        }
    )


def _lists(rows: Floats) -> Any:
    """Arrow list array of equally long rows."""
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * rows.shape[1]
    return pa.ListArray.from_arrays(offsets, np.ascontiguousarray(rows).ravel())


def read_result(folder: Path) -> Result:
    """Read the folder that `photocal adjust` wrote.

    raises InputNotFoundError: when the folder or one of its files is missing or empty.
    raises InputMalformedError: when a file is of another schema, cut, not a number where one must stand, or
        contradicts another.
    """
    if not folder.is_dir():
        what = "is a file, a folder was expected" if folder.exists() else "no such folder"
        raise InputNotFoundError(what, "give the folder that `photocal adjust` wrote", where=folder)
    text, _ = read_json(folder / RESULT, SCHEMA, "adjust with this version of photocal")
    content = checked(text, _File, folder / RESULT, AGAIN)
    cameras = {name: _camera(name, stored, folder / RESULT) for name, stored in content.cameras.items()}
    images = _images(folder, cameras)
    points = _points(folder)
    table = folder / "residuals.parquet"
    table = table if table.is_file() else folder / "residuals.csv"
    residuals = _residuals(table, images.names)
    _same_count(folder / "images.csv", len(images), content.images.n, "images")
    expected = [group.observations for group in content.groups if group.name == "image"]
    if expected:
        _same_count(table, 2 * len(residuals.accepted), expected[0], "image observations")
    names = [RESULT, "images.csv", "points.csv", table.name]
    names += [COVARIANCE] if (folder / COVARIANCE).is_file() else []
    figures = {field.name: getattr(content, field.name) for field in fields(Figures)}
    return Result(
        **figures,
        cameras=cameras,
        images=images,
        points=points,
        residuals=residuals,
        files=tuple(fingerprint(folder / name) for name in names),
    )


def read_json(path: Path, schema: str, remedy: str) -> tuple[str, dict[str, Any]]:
    """Read a file of JSON of a schema: its text and what that holds."""
    missing = InputNotFoundError.at(path)
    if not path.is_file():
        raise missing("does not exist", "give the folder that `photocal adjust` wrote")
    if path.stat().st_size > LARGEST_JSON:
        raise InputMalformedError("is no JSON of ours: it is too large", remedy, where=path)
    try:
        text = path.read_text(encoding="utf-8")
        if not text.strip():
            raise missing("the file is empty", remedy)
        content = read_checked_json(text)
    except UnicodeDecodeError as broken:
        raise InputMalformedError("is not UTF-8 text", remedy, where=f"{path}, byte {broken.start}") from None
    except json.JSONDecodeError as broken:
        raise InputMalformedError(
            f"is not complete JSON ({broken.msg})", remedy, where=f"{path}, line {broken.lineno}"
        ) from None
    except (ValueError, RecursionError) as broken:
        raise InputMalformedError(str(broken), remedy, where=path) from None
    stored = content.get("schema") if isinstance(content, dict) else None
    if stored != schema:
        raise InputMalformedError(f"schema is {stored!r}, {schema!r} was expected", remedy, where=path)
    return text, content


def cameras_of_json(content: object, path: Path) -> dict[str, Camera]:
    """Give the cameras of what `result_json` made; errors as of `read_result`."""
    known = checked(json.dumps(content), dict[str, _Camera], path, AGAIN, "cameras")
    return {name: _camera(name, stored, path) for name, stored in known.items()}


def heads_of_json(content: object, path: Path) -> tuple[AdjustedHead, ...]:
    """Give the heads of what `result_json` made; errors as of `read_result`."""
    return checked(json.dumps(content), tuple[AdjustedHead, ...], path, AGAIN, "heads")


@cache
def _adapter(kind: Hashable) -> "TypeAdapter[Any]":
    """What reads a kind; to make it takes longer than to read."""
    from pydantic import TypeAdapter

    return TypeAdapter(cast("Any", kind))


def checked(text: str, kind: type[Kind], path: Path, remedy: str, within: str = "") -> Kind:
    """Turn JSON into a dataclass; what does not fit is named by its key."""
    from pydantic import ValidationError

    try:
        value: Kind = _adapter(cast("Hashable", kind)).validate_json(text, strict=True)
    except ValidationError as refusal:
        first = refusal.errors()[0]
        place = ".".join([*([within] if within else []), *(str(step) for step in first["loc"])])
        raise InputMalformedError(f"{place}: {first['msg']}", remedy, where=path) from None
    return value


def _camera(name: str, stored: _Camera, path: Path) -> Camera:
    malformed = InputMalformedError.at(f"{path}, camera {name}")
    if "c" not in stored.parameters or not stored.parameters["c"].value > 0.0:
        raise malformed("has no positive principal distance c", AGAIN)
    if stored.unit == "mm" and (stored.pitch_mm is None or not min(stored.pitch_mm) > 0.0):
        raise malformed("has no positive pixel pitch", "give pitch_mm in block.toml")
    names = stored.correlation.names
    if len(stored.correlation.matrix) != len(names) or any(
        len(row) != len(names) for row in stored.correlation.matrix
    ):
        raise malformed(f"correlation matrix is not {len(names)} by {len(names)}", AGAIN)
    unknown = sorted(set(stored.parameters) - set(PARAMETERS))
    if unknown:
        raise malformed(f"{unknown[0]} is no parameter", AGAIN)
    if sorted(key for key, parameter in stored.parameters.items() if parameter.estimated) != sorted(names):
        raise malformed("correlation names differ from the estimated parameters", AGAIN)
    sigma, correlation = np.zeros(len(PARAMETERS)), np.eye(len(PARAMETERS))
    for key, entry in stored.parameters.items():
        if not (math.isfinite(entry.sigma) and entry.sigma >= 0.0):
            raise malformed(f"sigma of {key} is negative", AGAIN)
        sigma[PARAMETERS.index(key)] = entry.sigma
    rows = [PARAMETERS.index(key) for key in names]
    correlation[np.ix_(rows, rows)] = np.array(stored.correlation.matrix).reshape(len(names), len(names))
    adjusted = camera(
        name,
        stored.model,
        stored.unit,
        stored.size_px,
        stored.pitch_mm if stored.unit == "mm" and stored.pitch_mm else (1.0, 1.0),
        {key: parameter.value for key, parameter in stored.parameters.items()},
        estimate=names,
        prior_sigma={
            k: parameter.prior_sigma
            for k, parameter in stored.parameters.items()
            if parameter.prior_sigma is not None
        },
        reference_radius=stored.reference_radius,
        affinity=stored.affinity,
        affinity_form=stored.affinity_form,
        # Without its size (older versions did not write it) a deviation is free.
        photo_variant={
            key: stored.parameters[key].deviation_sigma or math.inf for key in stored.photo_variant
        },
        focus_m=stored.focus_m or 0.0,
    )
    given = [stored.parameters[key].given if key in stored.parameters else 0.0 for key in PARAMETERS]
    return replace(
        adjusted.adjusted(adjusted.values, sigma, correlation),
        guessed=stored.c_is_a_guess,
        distortion_at=stored.distortion_at,
        shutter=stored.shutter,
        readout_direction=stored.readout_direction,
        shake=stored.shake_rad,
        given=None if None in given else np.array(given, dtype=float),
    )


def _images(folder: Path, cameras: dict[str, Camera]) -> OrientedImages:
    path = folder / "images.csv"
    table = read_table(path, ("image", "camera", *PLACE, *ANGLES), (*IMAGE_SIGMAS, *MOTION, *SHAKE))
    names = table.unique_names("image")
    values = table.matrix((*ANGLES, *PLACE)) / SHOWN
    sigma = table.matrix(IMAGE_SIGMAS, empty=np.nan) / SHOWN
    camera_of = known_rows(table, "camera", tuple(cameras), RESULT)
    covariance = image_covariances(folder, names, sigma)
    movement = None
    if all(table.has(column) for column in MOTION):
        columns = MOTION + SHAKE if table.has(SHAKE[0]) else MOTION
        movement = table.matrix(columns)
        movement /= np.r_[SHOWN[::-1], np.full(len(SHAKE), SHOWN[0])][: len(columns)]
    return OrientedImages(names, tuple(cameras.values()), camera_of, values, covariance, movement)


def image_covariances(folder: Path, names: tuple[str, ...], sigma: Floats) -> Floats:
    """Covariances (rad, m, shape (n, 6, 6)): whole where the folder has them, else the sigmas squared."""
    whole = read_covariances(folder / COVARIANCE, "image", names, (*ANGLES, *PLACE))
    return np.where(np.isfinite(whole), whole / np.outer(SHOWN, SHOWN), _diagonal(sigma))


def _points(folder: Path) -> AdjustedPoints:
    table = read_table(folder / "points.csv", ("point", "role", *PLACE), (*(f"s{a}" for a in PLACE), "rays"))
    names = table.unique_names("point")
    index, roles = table.names("role")
    sigma = table.matrix(("sX", "sY", "sZ"), empty=np.nan)
    whole = read_covariances(folder / COVARIANCE, "point", names, PLACE)
    return AdjustedPoints(
        names,
        tuple(roles[k] for k in index),
        table.matrix(PLACE),
        np.where(np.isfinite(whole), whole, _diagonal(sigma)),
        table.numbers("rays", empty=0.0).astype(np.int64),
    )


def _diagonal(sigma: Floats) -> Floats:
    return np.asarray(sigma[:, :, None] ** 2 * np.eye(sigma.shape[1]))


def _residuals(path: Path, images: tuple[str, ...]) -> Residuals:
    table = read_table(path, ("image", "point", "x", "y", "vx", "vy"), ("rx", "ry", "wx", "wy"))
    image = known_rows(table, "image", images, "images.csv")
    point, point_names = table.names("point")

    v, r, w = (table.matrix((f"{name}x", f"{name}y"), empty=np.nan) for name in "vrw")
    return Residuals(images, point_names, image, point, table.matrix("xy"), v, r, w)


def read_covariances(path: Path, kind: str, names: tuple[str, ...], unknowns: Sequence[str]) -> Floats:
    """Read covariances of a kind by name from `covariance.parquet`, shape (n, k, k), in its units.

    NaN for those that it does not have, also when there is no such file.
    """
    k = len(unknowns)
    covariance = np.full((len(names), k, k), np.nan)
    if not path.is_file():
        return covariance
    try:
        table = pyarrow.parquet.read_table(
            path, columns=["kind", "id", "names", "lower"], filters=[("kind", "==", kind)]
        )
        ids = table["id"].cast(pa.string()).to_pylist()
        order, lower = _lower(table, unknowns)
    except (pa.ArrowException, OSError, ValueError, KeyError) as failure:
        raise InputMalformedError(
            f"is no table of covariances ({str(failure).splitlines()[0]})",
            "make the folder again",
            where=path,
        ) from failure
    whole = np.zeros((len(ids), k, k))
    whole[:, *np.tril_indices(k)] = lower
    whole += np.tril(whole, -1).swapaxes(1, 2)
    row = {name: n for n, name in enumerate(names)}
    rows = np.array([row.get(name, -1) for name in ids], dtype=np.int64)
    covariance[rows[rows >= 0]] = whole[rows >= 0][:, order][:, :, order]
    return covariance


def _lower(table: Any, unknowns: Sequence[str]) -> tuple[Integers, Floats]:
    """Order of the unknowns in the rows, and the lower triangles as an array."""
    k = len(unknowns)
    if not table.num_rows:
        return np.arange(k), np.zeros((0, k * (k + 1) // 2))
    names = table["names"].combine_chunks()
    written = names[0].as_py()
    flat = np.asarray(pc.list_flatten(table["lower"]), dtype=np.float64)
    if sorted(written) != sorted(unknowns) or len(flat) != table.num_rows * k * (k + 1) // 2:
        raise ValueError(f"unknowns {', '.join(map(str, written))}, expected {', '.join(unknowns)}")
    order = np.array([written.index(name) for name in unknowns], dtype=np.int64)
    return order, flat.reshape(table.num_rows, -1)


def _same_count(path: Path, count: int, expected: int, what: str) -> None:
    if count != expected:
        raise InputMalformedError(
            f"has {count} {what}, {RESULT} says {expected}", f"the table was cut; {AGAIN}", where=path
        )
