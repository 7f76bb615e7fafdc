"""The run folder: the one writer and the one reader of a result.

The files that a run was made from: found again by their hashes, and carried by a certificate.
"""

import math
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet

from photocal.base.arrays import Floats, Integers, as_plain
from photocal.base.checked_toml import checked_tables
from photocal.base.codec import object_of, parsed_json
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError
from photocal.base.files import digest, write_json
from photocal.base.text_tables import LONG_TABLE, known_rows, read_table, write_table
from photocal.block.camera_setup import CameraKeys, camera_keys, camera_of
from photocal.block.folder import IMAGE_SIGMAS
from photocal.block.model import InputFile, fingerprint
from photocal.block.results.result import (
    ANGLES,
    PLACE,
    SHOWN,
    AdjustedHead,
    AdjustedPoints,
    Figures,
    Residuals,
    Result,
)
from photocal.geometry.camera import MOTION, PARAMETERS, SHAKE, Camera
from photocal.geometry.oriented_images import OrientedImages

SCHEMA = "photocal.adjustment/1"
RESULT = "result.json"
COVARIANCE = "covariance.parquet"
AGAIN = "run `photocal adjust` again"
# What is called in `result.json` as in `[[camera]]`.
_SAME = {
    *("model", "unit", "size_px", "pitch_mm", "affinity", "affinity_form", "distortion_at"),
    *("readout_direction", "shake_rad"),
}
_SOME = {"shutter", "gust", "prior_correlation", "stated_by"}
# Of larger files it is not asked whether they were read before: their digests take as long as they do.
_SHARED_BYTES = 1 << 31


@dataclass(frozen=True, kw_only=True)
class _File(Figures):
    """What `result.json` holds."""

    schema: str
    cameras: dict[str, Any]
    images: dict[str, Any]


def result_json(result: Result) -> dict[str, Any]:
    """Content of `result.json`."""
    plain = {field.name: as_plain(getattr(result, field.name)) for field in fields(Figures)}
    for optional in ("ellipses", "reliability", "control_residuals", "lasers"):
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
    """The keys of `[[camera]]`, with what belongs to a parameter together."""
    said = camera_keys(camera)
    before, parameters = camera.values if camera.given is None else camera.given, {}
    for name in camera.lens.names if camera.rolling else camera.lens.names[:-1]:
        k, deviation = PARAMETERS.index(name), said.photo_variant.get(name, "free")
        prior = float(camera.prior_sigma[k])
        parameters[name] = {
            "value": camera.value(name),
            "given": float(before[k]),
            "sigma": camera.sigma_of(name),
            "estimated": name in said.estimate,
            "prior_sigma": prior if math.isfinite(prior) else None,
            **({} if deviation == "free" else {"deviation_sigma": deviation}),
        }
    # Of what shutters alone have, or few blocks state, older files say nothing.
    more = {"gust"} if camera.shutter != "global" else set()
    more |= {"prior_correlation"} if camera.prior_correlation is not None else set()
    more |= {"stated_by"} if camera.stated_by else set()
    return {
        **said.model_dump(mode="json", include=_SAME | more),
        "reference_radius": said.R0,
        "focus_m": camera.focus_m or None,
        "shutter": camera.shutter,
        "c_is_a_guess": camera.guessed and not camera.estimated[0],
        "photo_variant": list(said.photo_variant),
        "parameters": parameters,
        "correlation": {"names": list(camera.free), "matrix": camera.correlation_of(camera.free).tolist()},
    }


def write_result(folder: Path, result: Result) -> None:
    """Write `result.json` and the tables beside it into a folder that exists."""
    for name, table in result.tables().items():
        long = name == "residuals" and table.num_rows > LONG_TABLE
        write_table(folder / (f"{name}.parquet" if long else f"{name}.csv"), table)
    pyarrow.parquet.write_table(_covariances(result), folder / COVARIANCE)
    write_json(folder / RESULT, result_json(result))


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
    """Read the folder that `photocal adjust` wrote; the same files, there or copied, are read once.

    raises InputNotFoundError: when the folder or one of its files is missing or empty.
    raises InputMalformedError: when a file is of another schema, cut, not a number where one must stand, or
        contradicts another.
    """
    if not (folder / RESULT).is_file():
        what = "is a file, a folder was expected" if folder.exists() else "no such folder"
        what = f"has no {RESULT}" if folder.is_dir() else what
        raise InputNotFoundError(what, "give the folder that `photocal adjust` wrote", where=folder)
    table = folder / "residuals.parquet"
    table = table if table.is_file() else folder / "residuals.csv"
    names = (RESULT, "images.csv", "points.csv", table.name, COVARIANCE)
    there = [folder / name for name in names if (folder / name).is_file()]
    if sum(path.stat().st_size for path in there) > _SHARED_BYTES:
        # What cannot be a result is refused before all of it is read.
        unread = _read.__wrapped__(_RunFiles(folder, table, ()))
        return replace(unread, files=tuple(map(fingerprint, there)))
    return _read(_RunFiles(folder, table, tuple(map(fingerprint, there))))


@dataclass(frozen=True)
class _RunFiles:
    """The files of a run folder; equal ones elsewhere hold the same result."""

    folder: Path = field(compare=False)
    residuals: Path = field(compare=False)
    files: tuple[InputFile, ...]


# All stages of a run ask for one result, and so does what sums them up.
@lru_cache(maxsize=1)
def _read(run: _RunFiles) -> Result:
    folder, table = run.folder, run.residuals
    stored = read_json(folder / RESULT, SCHEMA, "adjust with this version of photocal")
    content = object_of(_File, stored, folder / RESULT, AGAIN)
    cameras = {name: _camera(name, stored, folder / RESULT) for name, stored in content.cameras.items()}
    images = _images(folder, cameras)
    points = _points(folder)
    residuals = _residuals(table, images.names)
    count = object_of(int, content.images.get("n"), folder / RESULT, AGAIN, "images.n")
    _same_count(folder / "images.csv", len(images), count, "images")
    expected = [group.observations for group in content.groups if group.name == "image"]
    if expected:
        _same_count(table, 2 * len(residuals.accepted), expected[0], "image observations")
    figures = {each.name: getattr(content, each.name) for each in fields(Figures)}
    return Result(
        **figures,
        cameras=cameras,
        images=images,
        points=points,
        residuals=residuals,
        files=run.files,
    )


def read_json(path: Path, schema: str, remedy: str) -> dict[str, Any]:
    """Read a file of JSON of a schema; errors as of `photocal.base.codec.parsed_json`."""
    content = parsed_json(path, remedy)
    stored = content.get("schema") if isinstance(content, dict) else None
    if stored != schema:
        raise InputMalformedError(f"schema is {stored!r}, {schema!r} was expected", remedy, where=path)
    return dict(content)


def cameras_of_json(content: object, path: Path) -> dict[str, Camera]:
    """Give the cameras of what `result_json` made; errors as of `read_result`."""
    known = object_of(dict[str, Any], content, path, AGAIN, "cameras")
    return {name: _camera(name, stored, path) for name, stored in known.items()}


def heads_of_json(content: object, path: Path) -> tuple[AdjustedHead, ...]:
    """Give the heads of what `result_json` made; errors as of `read_result`."""
    return object_of(tuple[AdjustedHead, ...], content, path, AGAIN, "heads")


@dataclass(frozen=True)
class _Parameter:
    """What `result.json` says of a parameter."""

    value: float
    sigma: float
    estimated: bool
    given: float | None = None
    prior_sigma: float | None = None
    deviation_sigma: float | None = None


def _camera(name: str, stored: Any, path: Path) -> Camera:
    """A camera of `result.json`, said in the keys of `[[camera]]`."""
    malformed = InputMalformedError.at(f"{path}, camera {name}")
    content = object_of(dict[str, Any], stored, path, AGAIN, f"cameras.{name}")
    where, own = f"cameras.{name}.parameters", content.get("parameters")
    parameters = object_of(dict[str, _Parameter], own, path, AGAIN, where)
    if not ("c" in parameters and parameters["c"].value > 0.0):
        raise malformed("has no positive principal distance c", AGAIN)
    if content.get("unit") == "mm" and not content.get("pitch_mm"):
        raise malformed("has no positive pixel pitch", "give pitch_mm in block.toml")
    for key, entry in parameters.items():
        if not (math.isfinite(entry.sigma) and entry.sigma >= 0.0):
            raise malformed(f"sigma of {key} is negative", AGAIN)
    varying = object_of(tuple[str, ...], content.get("photo_variant", ()), path, AGAIN, "photo_variant")
    unknown = [key for key in varying if key not in parameters]
    if unknown:
        raise malformed(f"{unknown[0]} is not a parameter", AGAIN)
    keys = {
        "id": name,
        **{key: content[key] for key in (*_SAME, *_SOME, "reference_radius") if key in content},
        "focus": {"distance_m": content["focus_m"]} if content.get("focus_m") else None,
        "guessed": content.get("c_is_a_guess", False),
        # Without its size (older versions did not write it) a deviation is free.
        "photo_variant": {key: parameters[key].deviation_sigma or "free" for key in varying},
        "parameters": {key: entry.value for key, entry in parameters.items()},
        "estimate": [key for key, entry in parameters.items() if entry.estimated],
        "prior_sigma": {k: e.prior_sigma for k, e in parameters.items() if e.prior_sigma is not None},
        "sigma": {key: entry.sigma for key, entry in parameters.items() if entry.sigma},
        "given": None
        if any(entry.given is None for entry in parameters.values())
        else {key: entry.given for key, entry in parameters.items()},
        "correlation": content.get("correlation"),
    }
    try:
        said = checked_tables(keys, CameraKeys, f"{path}, camera {name}")
        names = said.correlation.names if said.correlation is not None else ()
        made = camera_of(said, path)
    except ConfigurationError as wrong:
        raise InputMalformedError(wrong.what, AGAIN, where=wrong.where) from None
    if sorted(said.estimate) != sorted(names):
        raise malformed("correlation names differ from the estimated parameters", AGAIN)
    return replace(made, shutter=said.shutter or "global")


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
            f"is not a table of covariances ({str(failure).splitlines()[0]})",
            "adjust the block again",
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
            f"has {count} {what}, {RESULT} says {expected}", f"the table was truncated; {AGAIN}", where=path
        )


# Where a certificate carries them.
CARRIED = "inputs"


@dataclass(frozen=True)
class BlockSource:
    """What was adjusted.

    setup: the set-up file of another program within it; empty for a block folder.
    """

    folder: Path
    setup: str = ""

    @property
    def path(self) -> Path:
        """What `photocal adjust` takes: the block folder or the set-up file."""
        return self.folder / self.setup


def changed_inputs(inputs: Sequence[InputFile], folder: Path) -> dict[str, str]:
    """Say of which files, by their paths, that they are missing or not those that were adjusted."""
    changes = {}
    for file in inputs:
        path = folder / file.path
        now = digest(path) if path.is_file() else ""
        if not now:
            changes[file.path] = f"{file.path} is missing"
        elif now != file.sha256:
            hashes = f"SHA-256 {now[:12]}..., certified {file.sha256[:12]}..."
            changes[file.path] = f"{file.path} has changed ({hashes})"
    return changes


def block_of_run(run: Path, result: Figures, given: Path | None, here: Path) -> BlockSource:
    """Find what a run was made from and make sure that it has not changed.

    given: the block folder or set-up file, when the user named it.
    raises InputNotFoundError: when no folder has these files.
    raises InputMalformedError: when a file of the named folder has changed since the run.
    """
    setup = result.block.setup
    if given is not None:
        folder = _root(given, setup) if given.is_file() else given
        changed = changed_inputs(result.inputs, folder)
        if changed:
            raise InputMalformedError(
                "is not the file that the run was made from",
                "adjust the block again, or name the folder of this run",
                where=folder / next(iter(changed)),
            )
        return BlockSource(folder, setup)
    for folder in _candidates(run.resolve(), result, here):
        if not changed_inputs(result.inputs, folder):
            return BlockSource(folder, setup)
    raise InputNotFoundError(
        "no block folder with the files of this run was found beside it or below the current folder",
        "name it with --block, or adjust the block again if it has changed",
        where=run,
    )


def _candidates(run: Path, result: Figures, here: Path) -> Iterator[Path]:
    """Folders that may be it: the one that the run names, then the nearest to the run first."""
    # Folders below the current one that are looked into: `practice/site/work` is three deep.
    deepest = 3
    if result.block.source:
        yield run / result.block.source
    setup = result.block.setup or "block.toml"
    for base, depth in ((run, 0), (run.parent, 1), (here, deepest)):
        for level in range(depth + 1):
            yield from sorted(_root(path, setup) for path in base.glob("*/" * level + setup))


def _root(path: Path, setup: str) -> Path:
    """The folder within which a set-up file has this path."""
    return path.parents[max(len(PurePosixPath(setup).parts), 1) - 1]


def carry(inputs: Sequence[InputFile], source: BlockSource, folder: Path) -> None:
    """Copy the inputs of a run into the folder of a certificate; `folder`: the certificate's."""
    for file in inputs:
        copy = folder / CARRIED / file.path
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source.folder / file.path, copy)
