"""Reading images: the stored pixel grid as grey values, or a refusal that names the file.

The pixel grid is the stored one. An EXIF orientation other than 1 tells viewers to turn the picture; the
pixels here are never turned, so that column and row always belong to the sensor: the centre of the
upper-left stored pixel is (0, 0), whatever a viewer shows.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Bytes
from photocal.base.errors import InputMalformedError, InputNotFoundError, PhotocalError

if TYPE_CHECKING:
    from PIL.Image import Image

Measured = TypeVar("Measured")
Grey = Bytes | NDArray[np.uint16] | NDArray[np.float32]

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".jp2", ".pgm")
# Pictures that are not read: of telephones, and raw ones, which each maker writes in his own way.
UNREAD = (".heic", ".heif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf", ".gif")
# The largest aerial cameras have 500 million pixels; more is not an image but an attack on the memory.
LARGEST_PX = 700_000_000
SMALLEST_SIDE_PX = 16
# EXIF orientations that exchange width and height.
_ON_END = (5, 6, 7, 8)


def list_images(folder: Path) -> tuple[Path, ...]:
    """List the image files of a folder, by their names; of one without, those of the folders in it.

    raises InputNotFoundError: when the folder does not exist or has no image.
    raises InputMalformedError: when folders in it have images of the same names.
    """
    if not folder.is_dir():
        raise InputNotFoundError("is not a folder", "name the folder with the images", where=folder)
    files = [path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")]
    pictures = sorted(path for path in files if path.suffix.lower() in SUFFIXES)
    if not pictures:
        pictures = _of_heads(folder)
    unread = sorted({path.suffix for path in files if path.suffix.lower() in UNREAD})
    if not pictures and unread:
        raise InputNotFoundError(
            f"has only pictures that are not read ({', '.join(unread)})",
            "save them as JPEG or TIFF in full size, neither turned nor corrected for distortion",
            where=folder,
        )
    if not pictures:
        raise InputNotFoundError("has no image", f"it takes {', '.join(SUFFIXES)}", where=folder)
    return tuple(pictures)


def _of_heads(folder: Path) -> list[Path]:
    """Images of the folders in a folder, one for each camera of a frame."""
    below = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    pictures = [path for part in below for path in part.iterdir() if path.suffix.lower() in SUFFIXES]
    place: dict[str, Path] = {}
    for path in pictures:
        if path.name in place:
            raise InputMalformedError(
                f"has two pictures {path.name}, in {place[path.name].parent.name} and {path.parent.name}",
                "rename the pictures so that each has its own name",
                where=folder,
            )
        place[path.name] = path
    return sorted(pictures, key=lambda path: path.name)


def each_picture(
    paths: Iterable[Path], measure: Callable[[Path], Measured], done: Callable[[float], None] = lambda _: None
) -> tuple[list[Measured], list[dict[str, str]]]:
    """Measure pictures one by one, and give the reasons of those that are refused."""
    measured, left_out = [], []
    for path in paths:
        try:
            measured.append(measure(path))
        except PhotocalError as refusal:
            left_out.append({"image": path.name, "reason": refusal.what, "code": "unreadable"})
        done(1)
    return measured, left_out


@contextmanager
def opened(path: Path) -> Iterator[Image]:
    """Open an image; whatever is wrong with the file becomes one line that names it.

    yields: header read, pixels not yet.
    raises InputNotFoundError: when there is no such file or it is empty.
    raises InputMalformedError: when it is not an image, cut, or too large to be one.
    """
    from PIL import Image

    if not path.is_file():
        raise InputNotFoundError("does not exist", "check the name of the image", where=path)
    if path.stat().st_size == 0:
        raise InputNotFoundError("is empty (0 bytes)", "copy the image again", where=path)
    limit = Image.MAX_IMAGE_PIXELS
    try:
        # Our own limit below replaces the library's, which large aerial images exceed.
        Image.MAX_IMAGE_PIXELS = None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # By its name, the library would map a TIFF that viewers turn to memory with its sides exchanged.
            with path.open("rb") as file, Image.open(file) as image:
                _require_sensible(path, image.size)
                yield image
    except (OSError, SyntaxError, ValueError, EOFError, IndexError, MemoryError, OverflowError) as failure:
        if type(failure).__name__ == "UnidentifiedImageError":
            raise _unknown(path) from failure
        raise InputMalformedError(
            f"cannot be read ({failure})", "copy the image again or take it out", where=path
        ) from failure
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def stored_size(image: Image) -> tuple[int, int]:
    """Width and height of the stored grid of an image whose pixels are not read yet."""
    width, height = image.size
    return (height, width) if _turned_by_library(image) in _ON_END else (width, height)


def as_stored(image: Image) -> Image:
    """Decode an image on its stored grid."""
    from PIL.Image import Transpose

    orientation = _turned_by_library(image)
    image.load()
    if orientation == 1:
        return image
    back = {
        2: Transpose.FLIP_LEFT_RIGHT,
        3: Transpose.ROTATE_180,
        4: Transpose.FLIP_TOP_BOTTOM,
        5: Transpose.TRANSPOSE,
        6: Transpose.ROTATE_90,
        7: Transpose.TRANSVERSE,
        8: Transpose.ROTATE_270,
    }
    return image.transpose(back[orientation])


def _turned_by_library(image: Image) -> int:
    """By which EXIF orientation the library turns an image when it reads the pixels: it does so with TIFF."""
    if image.format != "TIFF":
        return 1
    orientation = image.getexif().get(0x0112, 1)
    return orientation if orientation in range(1, 9) else 1


def read_grey(path: Path) -> Grey:
    """Read the grey values of an image, on its stored pixel grid."""
    with opened(path) as image:
        # JPEG holds the luminance; decoding it alone saves the colours' time and memory.
        if image.format == "JPEG" and image.mode in ("RGB", "YCbCr"):
            image.draft("L", None)
        image = as_stored(image)
        if image.mode in ("I;16", "I;16B", "I;16L", "I;16N"):
            return np.asarray(image).astype(np.uint16)
        if image.mode == "I":
            values = np.asarray(image)
            sixteen_bits = values.size and values.min() >= 0 and values.max() < 65536
            return values.astype(np.uint16) if sixteen_bits else values.astype(np.float32)
        if image.mode == "F":
            return np.asarray(image, dtype=np.float32)
        return np.asarray(image.convert("L"), dtype=np.uint8)


def as_eight_bit(grey: Grey) -> Bytes:
    """Reduce grey values to 8 bits for detectors that know no more."""
    if grey.dtype == np.uint8:
        return np.asarray(grey, dtype=np.uint8)
    low, high = np.nanquantile(grey[::4, ::4], [0.001, 0.999])
    span = max(float(high - low), 1e-12)
    scaled = (np.nan_to_num(grey.astype(np.float32), nan=float(low)) - low) * (255.0 / span)
    return np.asarray(np.clip(scaled, 0, 255), dtype=np.uint8)


def _unknown(path: Path) -> InputMalformedError:
    """Say what a file is that the library does not take for an image."""
    with path.open("rb") as file:
        head = file.read(12)
    if head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return InputMalformedError(
            "is a TIFF of a kind that is not read",
            "save it with 8 or 16 bits a band, grey or RGB",
            where=path,
        )
    if head[4:8] == b"ftyp":
        return InputMalformedError(
            "is a HEIC or AVIF picture, which is not read, whatever its name",
            "save it as JPEG in full size",
            where=path,
        )
    return InputMalformedError("is not an image", "copy the image again or take it out", where=path)


def _require_sensible(path: Path, size: tuple[int, int]) -> None:
    width, height = size
    malformed = InputMalformedError.at(path)
    if width * height > LARGEST_PX:
        raise malformed(
            f"claims {width} x {height} pixels", f"is the header damaged? At most {LARGEST_PX:_} are read"
        )
    if min(size) < SMALLEST_SIDE_PX:
        raise malformed(f"has only {width} x {height} pixels", f"at least {SMALLEST_SIDE_PX} are needed")
