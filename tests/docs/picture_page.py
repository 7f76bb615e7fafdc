"""docs/pictures.md, from the table of picture facts: `python -m tests.docs` writes it anew."""

from __future__ import annotations

from pathlib import Path

from photocal.measurement.picture_facts import FACTS, Fact

PAGE = Path(__file__).parents[2] / "docs" / "pictures.md"
HEAD = """# What pictures say

Made from the one table of facts (`photocal/measurement/picture_facts.toml`). Pictures are asked before people
are: what stands here is not typed again. Keys are tags of EXIF by their names, or properties of XMP; the
first one that is written counts. A maker that is not in the table is left with EXIF, and with what he took
over under the same names. XMP is read as text: entities are not expanded, nothing outside the picture is
fetched, and length and number are bounded.

What differs among the pictures of one camera is a finding: focus or zoom, another body or lens, positions
without fixed ambiguities among fixed ones, corrections older than 10 s, distortion taken out in the camera,
sharpening, smear of the flight, a gimbal that turned over ([guide](guide/warnings.md)). What they say of
temperature, focus, exposure, serial numbers and firmware goes into the conditions of the certificate, with
the least, the median and the largest value.

A maker's calibration is a prior and not a truth. `DewarpData` and `DewarpDataK6` come in with sigmas that
cover a wrong ratio of fx and fy, a wrong sign of cx or cy, and decentring terms that are not there; B1 and
B2 are estimated with the rest. Where the adjustment finds the tag wrong, a note (`maker-tag`) says by
how many pixels in the corner of a picture. cy counts downwards, as OpenCV has it, but for the FC6360
(Phantom 4 Multispectral): its pictures show it to count upwards. c of a 35 mm equivalent goes by the
diagonal of 43.27 mm, with a sigma that covers the width of 36 mm.

Heights: `RtkAlt` and `GpsFusionAlt` of DJI are ellipsoidal, and so are heights with RTK; those of Parrot's
ANAFI and of Skydio are above the geoid EGM96; of others nothing is known, and `photocal new` says so.

The laser rangefinder of a thermal or zoom camera is a check of heights, and no observation: `photocal new`
lists its distances beside the flying height, and `photocal run` holds what the laser hit against the surface
of the adjusted tie points there (`laser-heights`: bias with its sigma, scatter, change with the distance).
`photocal flown --terrain DTM.tif` holds it against a terrain model instead.
Shots through the gaps of a canopy are counted and left out.

Thermal R-JPEG (H20T and its like) are measured by their preview, as any other picture: six of a Zenmuse H20T
over trees, 640 x 512, give 323 tie points with a sigma of 0.14 px. The radiometric counts beside the preview
(segments APP3, 16 bits) give 338 with 0.17 px when they are stretched, and 372 with 0.20 px when their
contrast is equalised locally: more points, poorer ones, so that they are not used.

| fact | unit | what it is | keys | where it is used |
|---|---|---|---|---|
"""


def page() -> str:
    """Write the page."""
    return HEAD + "".join(map(_row, FACTS))


def _row(fact: Fact) -> str:
    # Keys that differ in their prefix only are of makers who write the same.
    keys = "; ".join(f"`{key}`" for key in fact.keys if not key.startswith("drone-autel:"))
    return f"| `{fact.name}` | {fact.unit} | {fact.meaning} | {keys} | {fact.used} |\n"


def main() -> None:
    """Write it into docs."""
    PAGE.write_text(page(), encoding="utf-8")
