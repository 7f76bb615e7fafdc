"""Packed files from elsewhere: what damaged ones raise, and no more of them than memory holds."""

import gzip
import io
import struct
import zipfile
import zlib

# What a damaged, encrypted or exotic archive makes its reader raise.
DAMAGES = (zipfile.BadZipFile, zlib.error, struct.error, RuntimeError, EOFError, OSError, ValueError)


def unzipped(data: bytes, most: int) -> dict[str, bytes]:
    """Files of a zip by their names.

    raises one of DAMAGES: also where they are longer than `most` bytes together.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [member for member in archive.infolist() if not member.is_dir()]
        if sum(member.file_size for member in members) > most:
            raise ValueError(_too_long(most))
        return {member.filename: archive.read(member) for member in members}


def gunzipped(data: bytes, most: int) -> bytes:
    """Content of a gzip file.

    raises one of DAMAGES: also where it is longer than `most` bytes.
    """
    with gzip.GzipFile(fileobj=io.BytesIO(data)) as stream:
        content = stream.read(most + 1)
    if len(content) > most:
        raise ValueError(_too_long(most))
    return content


def _too_long(most: int) -> str:
    return f"longer than {most >> 20} MiB"
