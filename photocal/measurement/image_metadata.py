"""Images of a flight with the times of their own clock: from EXIF and XMP, file names or a table."""

import contextlib
import csv
import datetime as dt
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from re import compile as pattern

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError, InputNotFoundError
from photocal.exchange.source import read_text
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.image_file import list_images

# Time of the recording computer (UTC, hundredths) at the end of a file name.
_IN_NAME = pattern(r"(\d{14})(\d{2})Z$")


@dataclass(frozen=True)
class ImageMetadata:
    """One image.

    camera: maker, model and serial number as far as they are stated.
    time_s: seconds since 1970 by the camera's (or the file name's) clock, time zone unknown.
    resolution_s: 1 where only whole seconds are stated.
    from_name: whether the time is that of the recording computer in the file name (UTC).
    facts: what else the file says; None for a row of a table.
    utc: whether the time is the UTC of the exposure, by the receiver that the camera is connected to.
    """

    name: str
    camera: str
    time_s: float | None
    resolution_s: float
    from_name: bool
    facts: ImageFacts | None = None
    path: Path | None = None
    utc: bool = False


def read_images(source: Path) -> list[ImageMetadata]:
    """Read the images in a folder, or a table of images, by name.

    source: A folder of images, or a CSV table with columns image, taken (ISO 8601, the camera's clock) and
        optionally camera.
    raises InputNotFoundError: when the folder or table is missing or has no images.
    raises InputMalformedError: when a file cannot be read as an image, or a row of the table has no time.
    """
    if source.is_file():
        return _table(source)
    return [image_of(path, read_facts(path)) for path in list_images(source)]


def image_of(path: Path, facts: ImageFacts) -> ImageMetadata:
    """Metadata of an image that was read."""
    camera = " ".join(part for part in (facts.make, facts.model, facts.serial) if part) or "unknown"
    time: float | None = None
    resolution, from_name = 1.0, False
    stamp = _IN_NAME.search(path.stem)
    if facts.exposed_utc:
        time, resolution = _parsed(facts.exposed_utc) or (None, 1.0)
    elif facts.taken:
        time, resolution = _parsed(facts.taken) or (None, 1.0)
    elif stamp is not None:
        with contextlib.suppress(ValueError):
            moment = dt.datetime.strptime(stamp[1], "%Y%m%d%H%M%S").replace(tzinfo=dt.UTC)
            time, resolution, from_name = moment.timestamp() + int(stamp[2]) / 100, 0.01, True
    return ImageMetadata(
        path.name, camera, time, resolution, from_name, facts, path, utc=bool(facts.exposed_utc)
    )


def stated_places(facts: Sequence[ImageFacts | None]) -> Floats:
    """Return latitude, longitude (deg) and height (m) that images state (n, 3); NaN where they state none."""
    rows = [(f.latitude_deg, f.longitude_deg, f.altitude_m) if f else (np.nan,) * 3 for f in facts]
    return np.array(rows, np.float64).reshape(-1, 3)


def clock_time_s(image: ImageMetadata) -> float:
    """Return the time of an image's own clock."""
    if image.time_s is None:
        raise ConfigurationError(
            "has no time",
            "take it out of the folder or write DateTimeOriginal into its EXIF",
            where=image.name,
        )
    return image.time_s


def _parsed(taken: str) -> tuple[float, float] | None:
    """Return seconds since 1970 and their resolution of ``2016-06-23T16:31:59.25``."""
    whole, _, part = taken.rstrip("Z").replace(" ", "T").partition(".")
    try:
        moment = dt.datetime.fromisoformat(whole).replace(tzinfo=dt.UTC)
    except ValueError:
        return None
    if part and not part.isdigit():
        return None
    fraction = int(part) / 10 ** len(part) if part else 0.0
    return moment.timestamp() + fraction, 10.0 ** -len(part) if part else 1.0


def _table(path: Path) -> list[ImageMetadata]:
    try:
        reader = csv.DictReader(io.StringIO(read_text(path), newline=""))
        columns = reader.fieldnames or []
        rows = list(reader)
    except (OSError, csv.Error) as refusal:
        raise InputNotFoundError("cannot be read as a table", "check it", where=path) from refusal
    if not {"image", "taken"} <= set(columns):
        raise InputMalformedError("lacks the column image or taken", "give image,taken[,camera]", where=path)
    if not rows:
        raise InputNotFoundError("has no images", "give one row for each image", where=path)
    images = []
    for number, row in enumerate(rows, 2):
        time = _parsed((row["taken"] or "").strip())
        if not row["image"] or time is None or not math.isfinite(time[0]):
            raise InputMalformedError(
                f"{row['taken']!r} is not a time",
                "write it as 2025-06-15T12:30:05.250",
                where=f"{path}, line {number}",
            )
        camera = (row.get("camera") or "").strip() or "camera"
        images.append(ImageMetadata(row["image"].strip(), camera, *time, False))
    return sorted(images, key=lambda image: image.name)
