"""What a person leaves out of a block with a reason, and how it stands in the project file."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomlkit
from tomlkit.items import AoT

from photocal.base.arrays import Flags
from photocal.base.codec import toml_document
from photocal.base.errors import ConfigurationError
from photocal.base.files import write_file
from photocal.block.model import ROLES, Block
from photocal.block.project import LeaveOutKeys
from photocal.findings.finding import Finding

_SECTION = "leave_out"
_ON_MARKS = ("mark-off", "mark-left-out", "marks-apart", "control-off", "control-far")


def left_out(block: Block, chosen: Sequence[LeaveOutKeys]) -> tuple[Block, tuple[Finding, ...]]:
    """Take out what a person chose, and tie points that are then seen once; tell each with its reason."""
    seen = block.observations
    points, images = (np.array(part.names, dtype=object) for part in (block.points, block.images))
    ray, point, image = (np.zeros(len(part), dtype=np.bool_) for part in (seen.image, points, images))
    findings = []
    for entry in chosen:
        whole_point, whole_image = entry.image is None, entry.point is None
        of_point, of_image = points == entry.point, images == entry.image
        here = (of_point | whole_image)[seen.point] & (of_image | whole_point)[seen.image]
        ray |= here
        point |= of_point & whole_point
        image |= of_image & whole_image
        place = " / ".join(filter(None, (entry.point, entry.image)))
        figures = {"place": place, "rays": float(here.sum()), "reason": entry.reason}
        figures |= {"point": entry.point or "", "image": entry.image or ""}
        clauses = () if here.any() else ("takes-no-part",)
        findings.append(Finding("left-out-by-hand", "note", place, figures, clauses))
    return _without(block, ray, point, image), tuple(findings)


def settled(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Give findings without those on single marks and points that a person has left out since."""
    given = tuple(findings)
    by_hand = {(f.figures["point"], f.figures["image"]) for f in given if f.code == "left-out-by-hand"}

    def stays(finding: Finding) -> bool:
        """Whether what it tells of still takes part; one line on many marks tells of others, too."""
        if finding.code not in _ON_MARKS or "n" in finding.figures:
            return True
        point, image = finding.figures.get("point", finding.subject), finding.figures.get("image", "")
        return by_hand.isdisjoint({(point, image), (point, ""), *([("", image)] if image else [])})

    return tuple(finding for finding in given if stays(finding))


def _without(block: Block, ray: Flags, point: Flags, image: Flags) -> Block:
    seen = block.observations.rows(~ray)
    rays = np.bincount(seen.point, minlength=len(point))
    lonely = (rays == 1) & (block.points.role != ROLES.index("control"))
    gone = point | ((lonely | (rays == 0)) & block.points.of_role("tie"))
    left = replace(block, observations=seen.rows(~lonely[seen.point])).of_points(~gone)
    return left.of_images(~image) if image.any() else left


def leave_out(path: Path, entry: LeaveOutKeys) -> None:
    """Write what is left out into a project file; all else in it stays as it is, comments and order too.

    What is left out already gets the new reason.

    raises InputMalformedError, OutputError: when the file cannot be read, or written.
    """
    document = toml_document(path)
    _take_back(document, entry)
    if _SECTION not in document:
        document.add(tomlkit.nl())
        document.append(_SECTION, tomlkit.aot())
    table = tomlkit.table()
    table.update(entry.model_dump(exclude_none=True))
    document[_SECTION].append(table)
    write_file(path, tomlkit.dumps(document))


def take_back(path: Path, entry: LeaveOutKeys) -> None:
    """Take something into the block again; errors as of `leave_out`.

    raises ConfigurationError: when it is not left out.
    """
    document = toml_document(path)
    if not _take_back(document, entry):
        raise ConfigurationError(
            "is not in the list of data left out by hand", "check [[leave_out]]", where=path
        )
    write_file(path, tomlkit.dumps(document))


def _take_back(document: tomlkit.TOMLDocument, entry: LeaveOutKeys) -> bool:
    listed = document.get(_SECTION)
    if not isinstance(listed, AoT):
        return False
    keys = entry.image, entry.point
    same = [k for k, table in enumerate(listed) if (table.get("image"), table.get("point")) == keys]
    for k in reversed(same):
        del listed[k]
    if not listed:
        document.remove(_SECTION)
    return bool(same)
