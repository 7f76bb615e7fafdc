"""docs/pictures.md, from the table of picture facts: `python -m tests.docs` writes it anew."""

from __future__ import annotations

from pathlib import Path

from photocal.measurement.picture_facts import FACTS, Fact

PAGE = Path(__file__).parents[2] / "docs" / "pictures.md"
HEAD = """# Metadata of pictures

Made from the table of facts (`photocal/measurement/picture_facts.toml`). Values that a picture states are not
asked for. Keys are names of EXIF tags or XMP properties; the first key that is present is used. For a maker
that is not in the table, EXIF is read, and the XMP keys of other makers that it uses as well. XMP is read as
text: entities are not expanded, nothing outside the picture is fetched, and length and number are bounded.

Differences among the pictures of one camera are findings ([guide](guide/warnings.md)): focus or zoom, another
body or lens, positions without fixed ambiguities among fixed ones, corrections older than 10 s, distortion
removed in the camera, sharpening, motion blur, a gimbal that turned over. Temperature, focus, exposure,
serial numbers and firmware are printed in the conditions of the certificate, with minimum, median and
maximum.

A maker's calibration is used as a prior. The sigmas of `DewarpData` and `DewarpDataK6` cover a wrong ratio of
fx and fy, a wrong sign of cx or cy, and missing decentring terms; B1 and B2 are estimated with the rest. When
the adjustment finds the tag wrong, a note (`maker-tag`) states the error in pixels in the corner of a
picture. cy is positive downwards, as in OpenCV; only in pictures of the FC6360 (Phantom 4 Multispectral) it
is positive upwards. c of a 35 mm equivalent follows from the diagonal of 43.27 mm, with a sigma that covers
the width of 36 mm. Where EXIF states another size than the file has, what is stated in pixels is scaled to
the stored ones (reduced pictures), or refers to the whole frame (cropped ones); `photocal new` names both.

Heights: `RtkAlt` and `GpsFusionAlt` of DJI are ellipsoidal, and so are heights with RTK. Those of Parrot's
ANAFI and of Skydio are above the geoid EGM96. For other makers the kind is not known, and `photocal new`
reports this.

The laser rangefinder of a thermal or zoom camera checks heights; it is an observation only on request.
`photocal new` lists its distances with the flying height. `photocal run` compares the laser's targets with
the surface of the adjusted tie points there (`laser-heights`: bias with its sigma, scatter, change with the
distance); `photocal flown --terrain DTM.tif` compares them with a terrain model. Shots through gaps of a
canopy are left out and counted.

With `laser = "observation"` in `[images]` the distances are observations of the adjustment, and no longer a
check. Each is the distance along the axis of the camera to the plane through three tie points about its
target. Its sigma is that of the laser (the maker's 0.2 m and 0.15 %, taken as three sigmas), together with
the roughness of the surface: the deviation of the eight nearest tie points from a plane. All distances share
an offset and a scale with the same sigmas, since most of a rangefinder's error is the same in every shot:
more shots do not make the laser better than its specification. Before that, the block is adjusted without the
laser, and shots that differ from the others by more than four sigmas are left out and named
(`laser-observations`). `laser-offset` tests the offset against the rest of the block, and names shots whose
standardised residual is too large; `result.json` has all of them (`lasers`). At most 200 shots are used.
Benefit: over a field, at one height with a steady gimbal and RTK, where c is weakly determined, the accuracy
of heights becomes 0.08 m instead of 0.33 m; with positions of metre accuracy it gives the block its scale.
Where heights are already known to a decimetre it has no benefit, and is better used as a check.

Thermal R-JPEG (H20T and similar) are measured in their preview, as any other picture: six of a Zenmuse H20T
over trees, 640 x 512, give 323 tie points with a sigma of 0.14 px. The radiometric counts beside the
preview (segments APP3, 16 bits) are not used, since they give more but poorer points: 338 with 0.17 px when
they are stretched, and 372 with 0.20 px when their contrast is equalised locally.

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
