"""Reading images: the stored pixel grid as grey values, or a refusal that names the file.

The pixel grid is the stored one. An EXIF orientation other than 1 tells viewers to turn the picture; the
pixels here are never turned, so that column and row always belong to the sensor: the centre of the
upper-left stored pixel is (0, 0), whatever a viewer shows.
"""

from __future__ import annotations

import io
import struct
import unicodedata
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Bytes
from photocal.base.errors import InputMalformedError, InputNotFoundError, PhotocalError
from photocal.base.operating_system import available_memory

if TYPE_CHECKING:
    from PIL.Image import Image

Measured = TypeVar("Measured")
Grey = Bytes | NDArray[np.uint16] | NDArray[np.float32]

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".jp2", ".pgm")
# Pictures that are not read: of telephones, and raw ones, which each maker writes in his own way.
UNREAD = (".heic", ".heif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf", ".gif")
_STORED_BYTES = {"1": 1, "L": 1, "P": 1, "I;16": 2, "I;16B": 2, "I;16L": 2, "I;16N": 2}
# What a PNG says beside its pixels: EXIF, and texts, of which one may be XMP.
_PNG_NOTES, _PNG_HEAD, _LONGEST_NOTE = (b"eXIf", b"iTXt", b"tEXt", b"zTXt"), 33, 1 << 24
# Grey values from and to which a picture shows no detail.
WHITE, BLACK = 250, 5
# EXIF orientations that exchange width and height.
_ON_END = (5, 6, 7, 8)


class PictureTooLargeError(InputMalformedError):
    """A picture that the memory of this computer does not hold: no reason to go on without it."""


def list_images(folder: Path) -> tuple[Path, ...]:
    """List the image files of a folder, by their names; of one without, those of the folders in it.

    folder: may be a pattern of names with * and ?, such as `DCIM/DJI_*/*_W.JPG`, where it is not a folder.

    raises InputNotFoundError: when the folder does not exist or has no image.
    raises InputMalformedError: when folders in it have images of the same names.
    """
    at = next((k for k, part in enumerate(folder.parts) if set(part) & {"*", "?"}), 0)
    root, pattern = folder, "*"
    if at and not folder.is_dir():
        root, pattern = Path(*folder.parts[:at]), "/".join(folder.parts[at:])
    if not root.is_dir():
        raise InputNotFoundError("is not a folder", "name the folder with the images", where=root)
    files = [path for path in root.glob(pattern) if path.is_file() and not path.name.startswith(".")]
    pictures = [path for path in files if path.suffix.lower() in SUFFIXES]
    if not pictures and root != folder:
        raise InputNotFoundError("does not match any image", f"it takes {', '.join(SUFFIXES)}", where=folder)
    if not pictures:
        # The folders in it, one for each camera of a frame.
        below = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
        pictures = [path for part in below for path in part.iterdir() if path.suffix.lower() in SUFFIXES]
    require_names(pictures)
    unread = sorted({path.suffix for path in files if path.suffix.lower() in UNREAD})
    if not pictures and unread:
        raise InputNotFoundError(
            f"has only pictures that cannot be read ({', '.join(unread)})",
            "save them as JPEG or TIFF in full size, neither turned nor corrected for distortion",
            where=folder,
        )
    if not pictures:
        raise InputNotFoundError("has no image", f"it takes {', '.join(SUFFIXES)}", where=folder)
    place: dict[str, Path] = {}
    for path in pictures:
        if path.name in place:
            raise InputMalformedError(
                f"has two pictures {path.name}, in {place[path.name].parent.name} and {path.parent.name}",
                "rename the pictures so that each has its own name",
                where=folder,
            )
        place[path.name] = path
    return tuple(sorted(pictures, key=lambda path: path.name))


def require_names(paths: Iterable[Path]) -> None:
    """Complain of a name that no table can hold; raises InputMalformedError."""
    for path in paths:
        # What is no UTF-8 comes as single surrogates.
        if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in path.name):
            raise InputMalformedError(
                "the name of this picture is not in UTF-8, or has control characters",
                "rename the picture",
                where=path,
            )


def left_out_entry(image: str, reason: str, code: str) -> dict[str, str]:
    """Say why a picture is not used, for people and by the code of the cause."""
    return {"image": image, "reason": reason, "code": code}


def each_picture(
    paths: Iterable[Path], measure: Callable[[Path], Measured], done: Callable[[float], None] = lambda _: None
) -> tuple[list[Measured], list[dict[str, str]]]:
    """Measure pictures one by one, and give the reasons of those that are refused."""
    measured, left_out = [], []
    for path in paths:
        try:
            measured.append(measure(path))
        except PictureTooLargeError:
            raise
        except PhotocalError as refusal:
            left_out.append(left_out_entry(path.name, refusal.what, "unreadable"))
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
            f"cannot be read ({failure})", "copy the image again or remove it", where=path
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
    _require_memory(image)
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
        return np.asarray(image if image.mode == "L" else image.convert("L"), dtype=np.uint8)


def as_eight_bit(grey: Grey) -> Bytes:
    """Reduce grey values to 8 bits for detectors that know no more."""
    if grey.dtype == np.uint8:
        return np.asarray(grey, dtype=np.uint8)
    low, high = np.nanquantile(grey[::4, ::4], [0.001, 0.999])
    span = max(float(high - low), 1e-12)
    scaled = (np.nan_to_num(grey.astype(np.float32), nan=float(low)) - low) * (255.0 / span)
    return np.asarray(np.clip(scaled, 0, 255), dtype=np.uint8)


def noted(image: Image) -> Image:
    """Give an image that tells what another says beside its pixels.

    The library decodes a whole PNG to see whether notes follow its pixels: they are found by their lengths.
    """
    from PIL import Image as Library

    file: IO[bytes] | None = getattr(image, "fp", None)
    if image.format != "PNG" or file is None:
        return image
    tiny, place = io.BytesIO(), file.tell()
    Library.new("L", (1, 1)).save(tiny, "PNG")
    whole = tiny.getvalue()
    try:
        notes = b"".join(_png_notes(file))
        found = Library.open(io.BytesIO(whole[:_PNG_HEAD] + notes + whole[_PNG_HEAD:]))
        found.load()
    except (OSError, SyntaxError, ValueError, EOFError):
        # What is damaged tells nothing.
        return Library.open(io.BytesIO(whole))
    finally:
        file.seek(place)
    return found


def _png_notes(file: IO[bytes]) -> Iterator[bytes]:
    file.seek(8)
    while len(head := file.read(8)) == 8:
        length, kind = struct.unpack(">I4s", head)
        if kind in _PNG_NOTES and length <= _LONGEST_NOTE:
            yield head + file.read(length + 4)
        else:
            file.seek(length + 4, io.SEEK_CUR)


def _require_memory(image: Image) -> None:
    """Look at the memory before pixels fill it: else the system may end the program, or others."""
    free = available_memory()
    # Beside the picture itself: grey values, what is searched for in them, and the space of that search.
    # Measured on 700 million pixels of 8 bits: 4.4 bytes in all.
    working_bytes = 4
    needed = image.width * image.height * (working_bytes + _STORED_BYTES.get(image.mode, 4))
    if free is not None and needed > free:
        raise PictureTooLargeError(
            f"its {image.width} x {image.height} pixels take about {needed / 1e9:.1f} GB of memory, "
            f"{free / 1e9:.1f} GB are free",
            "close other programs, take fewer workers, or a computer with more memory",
            where=getattr(getattr(image, "fp", None), "name", None),
        )


def _unknown(path: Path) -> InputMalformedError:
    """Say what a file is that the library does not take for an image."""
    with path.open("rb") as file:
        head = file.read(12)
    if head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return InputMalformedError(
            "is a TIFF of an unsupported kind",
            "save it with 8 or 16 bits a band, grey or RGB",
            where=path,
        )
    if head[4:8] == b"ftyp":
        return InputMalformedError(
            "is a HEIC or AVIF picture, which is not supported, whatever its name",
            "save it as JPEG in full size",
            where=path,
        )
    return InputMalformedError("is not an image", "copy the image again or remove it", where=path)


def _require_sensible(path: Path, size: tuple[int, int]) -> None:
    width, height = size
    malformed = InputMalformedError.at(path)
    # The largest aerial cameras have 500 million pixels; more is not an image but an attack on the memory.
    largest_px = 700_000_000
    if width * height > largest_px:
        raise malformed(
            f"states {width} x {height} pixels", f"is the header damaged? At most {largest_px:_} are read"
        )
    # Smaller ones are icons, no photographs.
    smallest_side_px = 16
    if min(size) < smallest_side_px:
        raise malformed(f"has only {width} x {height} pixels", f"at least {smallest_side_px} are needed")
