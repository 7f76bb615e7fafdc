"""Which program a file is from, and the block that it holds."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from drivers.errors import InputMalformedError, InputNotFoundError
from photocal.block.model import Block
from photocal.exchange import models
from photocal.exchange.jaicov import SUFFIXES
from photocal.exchange.markup import read_xml

READABLE = (
    "a DBAT set-up (.xml), a PhotoModeler text export, a JAICOV file (.ior, .eor, .obc, .phc), a PhotoScan "
    "project (.psz), a Metashape camera XML, a COLMAP model (cameras.txt or .bin), an OpenSfM "
    "reconstruction.json, or an OPF project (.opf)"
)


def read_foreign_block(path: Path) -> Block:
    """Read a block of another program."""
    if not path.exists():
        raise InputNotFoundError("does not exist", where=path, remedy="check the path")
    block = _read(path)
    root = os.path.commonpath([Path(file.path).parent for file in block.inputs])
    inputs = (replace(file, path=Path(file.path).relative_to(root).as_posix()) for file in block.inputs)
    return replace(block, inputs=tuple(inputs))


def _read(path: Path) -> Block:
    if path.suffix.lower() == ".xml":
        return _from_xml(path)
    if path.suffix.lower() in SUFFIXES:
        from photocal.exchange.jaicov import read_jaicov

        return read_jaicov(path)
    if path.suffix.lower() == ".psz":
        from photocal.exchange.photoscan import read_photoscan

        return read_photoscan(path)
    if path.suffix.lower() == ".opf":
        return models.read_opf_block(path)
    if path.suffix.lower() == ".json":
        return models.read_opensfm_block(path)
    if path.suffix.lower() in (".txt", ".bin") and path.stem in models.COLMAP_FILES:
        return models.read_colmap_block(path)
    if path.suffix.lower() == ".txt":
        from photocal.exchange.photomodeler import control_beside, read_photomodeler
        from photocal.exchange.photomodeler_export import looks_like_export

        if looks_like_export(path):
            control = control_beside(path)
            return read_photomodeler(path, control if control.exists() else None)
    raise _unknown(path)


def _from_xml(path: Path) -> Block:
    root = read_xml(path)
    if "dbat_script_version" in root.attrib:
        from photocal.exchange.dbat import read_dbat

        return read_dbat(path)
    if root.tag == "document":
        return models.read_metashape_block(path)
    raise _unknown(path)


def _unknown(path: Path) -> InputMalformedError:
    return InputMalformedError(
        "holds no block that is known", where=path, remedy=f"name a block folder, {READABLE}"
    )
