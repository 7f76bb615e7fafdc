"""Record of a measurement: its figures, what was left out and why, marks that do not fit.

A block that was measured, and the record of how.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Bytes, Floats
from photocal.base.errors import PhotocalError
from photocal.base.files import write_json
from photocal.base.policy import policy
from photocal.block.model import Block
from photocal.block.writer import write_block
from photocal.findings.finding import Finding, Severity
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.image_file import BLACK, WHITE, as_eight_bit, read_grey
from photocal.measurement.match_images import SAME, ImageTracks
from photocal.measurement.oriented_ties import Oriented
from photocal.measurement.released_c import camera_figures, with_released_c
from photocal.measurement.tie_adjustment import AdjustedTies, by_ray, pixel_residuals
from photocal.measurement.tie_block import GROSS

# Of `measurement.json`.
SCHEMA = "photocal.measurement/1"
RECORD = "measurement.json"
PIXEL_ORIGIN = "centre of the upper-left stored pixel is (0, 0); EXIF orientation is not applied"


@dataclass(frozen=True)
class MeasuredBlock:
    """A measured block and the record of its measurement.

    Attributes
    ----------
    block
        Cameras, images, points and observations.
    record
        Content of `measurement.json`: what was measured, left out and found doubtful.
    """

    block: Block
    record: dict[str, Any]

    def write(self, folder: Path) -> None:
        """Write the block folder and the record of its measurement."""
        write_block(folder, self.block)
        write_json(folder / RECORD, self.record, 2)


# Pictures that sharpness is compared with.
OTHERS = 3


def tie_record(tracked: ImageTracks, oriented: Oriented) -> dict[str, Any]:
    """What was measured and how, for `measurement.json`."""
    paths = {source.path.name: source.path for source in tracked.sources}
    final = oriented.adjusted
    residuals = pixel_residuals(final.assembly, final.solution)[-len(final.tracks.track) :]
    return {
        "schema": SCHEMA,
        "images": list(final.block.images.names),
        "turned_by_exif": [f.name for f in tracked.facts if f.orientation != 1],
        "left_out": [*tracked.left_out, *explained(oriented.left_out, paths, tracked.facts)],
        "pairs": {
            "rule": tracked.rule,
            "examined": tracked.matched_pairs,
            "verified": tracked.verified_pairs,
        },
        "tracks": {
            "of_features": tracked.tracks.count,
            "conflicts_removed": tracked.tracks.conflicts,
            "all": len(oriented.verified),
            "three_and_more_rays": int(np.count_nonzero(oriented.verified >= 3)),
        },
        "pixel_origin": PIXEL_ORIGIN,
        "points": final.tracks.count,
        "observations": len(final.tracks.track),
        "rejected_observations": final.rejected,
        "points_by_rays": {str(n): int(c) for n, c in enumerate(np.bincount(final.tracks.rays)) if c},
        "share_of_four_and_more": float(np.mean(final.tracks.rays >= 4)),
        "rms_px": float(np.sqrt(np.mean(residuals**2))),
        "sigma_px": final.tie_sigma,
        "variance_factor": float(final.solution.variance_factor),
        "cameras": camera_figures(final, with_released_c(final)),
    }


def position_figures(facts: Sequence[ImageFacts], sigma: Floats) -> dict[str, Any]:
    """How well the positions were taken to be known, and who said so; `sigma` (images, 3)."""
    stated = [bool(np.isfinite(f.position_sigma_m).all()) for f in facts if f.has_position]
    known = sigma[np.isfinite(sigma).all(axis=1)]
    return {
        "images": len(stated),
        "sigma_stated_by_image": sum(stated),
        "sigma_m": np.sqrt(np.mean(known**2, axis=0)).tolist() if len(known) else None,
    }


def explained(
    left_out: Iterable[Mapping[str, str]], paths: Mapping[str, Path], facts: Sequence[ImageFacts]
) -> list[dict[str, str]]:
    """Reasons with what the picture itself has to do with them."""
    entries = [dict(entry) for entry in left_out]
    gone = {entry["image"] for entry in entries}
    of_image = {image.name: image for image in facts}
    cameras = Counter(_camera_name(image) for image in facts if image.name not in gone)
    usual = cameras.most_common(1)[0][0] if cameras else ""
    others = [path for name, path in paths.items() if name not in gone] if gone & set(paths) else []
    pictures = [grey for path in others[:OTHERS] if (grey := _read(path)) is not None]
    sharp = [_sharpness(grey) for grey in pictures]
    for entry in entries:
        image, path = of_image.get(entry["image"]), paths.get(entry["image"])
        if image is None or path is None:
            continue
        also = (
            [f"taken by another camera ({_camera_name(image)})"]
            if usual and _camera_name(image) != usual
            else []
        )
        also += _appearance(_read(path), sharp)
        entry["reason"] = "; ".join([entry["reason"], *also])
    return entries


def _camera_name(image: ImageFacts) -> str:
    width, height = image.size_px
    return " ".join(part for part in (image.model or image.make, f"{width} x {height} px") if part)


def _read(path: Path) -> Bytes | None:
    try:
        return as_eight_bit(read_grey(path))
    except PhotocalError:
        return None


def _appearance(grey: Bytes | None, sharp: Sequence[float]) -> list[str]:
    if grey is None:
        return []
    white, black = float(np.mean(grey >= WHITE)), float(np.mean(grey <= BLACK))
    # Share of a picture without detail, white or black, of which nothing can be seen.
    burnt = 0.4
    if white > burnt:
        return [f"over-exposed: {white:.0%} of it is white"]
    if black > burnt:
        return [f"under-exposed: {black:.0%} of it is black"]
    # Sharpness beside that of the others when a picture is blurred.
    blurred = 0.4
    if len(sharp) == OTHERS and _sharpness(grey) < blurred * float(np.median(sharp)):
        return ["blurred"]
    return []


def _sharpness(grey: Bytes) -> float:
    """Finest detail over all contrast."""
    import cv2

    fine = cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), 1.0), cv2.CV_32F)
    return float(fine.std() / max(float(grey.std()), 1.0))


def suspected_marks(adjusted: AdjustedTies) -> list[dict[str, Any]]:
    """Marks whose residual is too large for their sigma, the largest first."""
    block = adjusted.block
    size, redundancy = by_ray(adjusted.assembly, adjusted.solution)
    seen = block.observations
    spread = np.sqrt((seen.sigma**2).sum(axis=1) * np.maximum(redundancy, policy.least_checked))
    share = size / spread
    marked = seen.point < len(adjusted.start.points.names)
    # With fewer marks nobody knows what they scatter by.
    fewest_marks = 20
    # What the model of this stage lacks, such as vibration within a readout, moves all marks: none is off.
    # Squares of such shares are exponential, with a median of ln 2 where the sigmas are right.
    typical = np.median(share[marked]) / np.sqrt(np.log(2.0)) if marked.sum() >= fewest_marks else 1.0
    bad = np.flatnonzero(marked & (share > GROSS * max(1.0, typical)))
    order = bad[np.argsort(-share[bad])]
    return [
        {
            "image": block.images.names[seen.image[k]],
            "point": block.points.names[seen.point[k]],
            "residual_px": float(size[k]),
            "in_sigmas": float(share[k]),
        }
        for k in order
    ]


def findings_of_marks(
    lost: Sequence[Finding],
    strangers: Sequence[str],
    suspects: Sequence[dict[str, Any]],
    left_out: Sequence[dict[str, str]],
) -> list[Finding]:
    """Find what must not pass silently: images, marks and targets that are not used, marks far off."""
    findings = []
    for cause in dict.fromkeys(entry.get("code", "unusable") for entry in left_out):
        images = tuple(entry["image"] for entry in left_out if entry.get("code", "unusable") == cause)
        weight: Severity = "note" if cause == SAME else "doubtful"
        findings.append(Finding("image-left-out", weight, figures={"images": images}, cause=cause))
    findings += lost
    findings += [Finding("unknown-target", "doubtful", name) for name in strangers]
    return findings + _marks_off(suspects)


def _marks_off(suspects: Sequence[dict[str, Any]]) -> list[Finding]:
    """Each mark that is far off; of many the worst, with their number and those that come next."""
    places = [f"{suspect['point']} ({suspect['image']})" for suspect in suspects]
    findings = []
    # Of more marks that do not fit only the worst are named.
    marks_named = 3
    for suspect, name in zip(suspects, places, strict=True):
        figures = {"point": suspect["point"], "image": suspect["image"]}
        figures |= {"px": suspect["residual_px"], "sigmas": suspect["in_sigmas"]}
        if len(suspects) > marks_named:
            figures |= {"n": float(len(suspects) - 1), "marks": tuple(places[1 : marks_named + 1])}
            return [Finding("mark-off", "doubtful", name, figures, ("marks-off",))]
        findings.append(Finding("mark-off", "doubtful", name, figures))
    return findings
