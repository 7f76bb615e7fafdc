"""OpenSfM: its own normalised coordinates, its published example, damaged files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from photocal.base.errors import InputMalformedError
from photocal.block.model import Block
from photocal.exchange.opensfm import read_reconstruction, read_shots
from photocal.exchange.opensfm import write as write_opensfm
from photocal.exchange.pinhole import to_vision
from photocal.geometry.camera import plane_to_pixel
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import matrix_from_angles


def test_opensfm_round_trip(tmp_path: Path, vision: Block) -> None:
    named = replace(vision, cameras=tuple(replace(own, id=f"v{k}") for k, own in enumerate(vision.cameras)))
    assert all(made.largest_px == 0 for made in write_opensfm(tmp_path, named))
    again = read_reconstruction(tmp_path / "reconstruction.json")
    np.testing.assert_allclose(again.images.values, vision.images.values, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(again.points.values, vision.points.values, rtol=1e-12)
    whole = json.loads((tmp_path / "reconstruction.json").read_text())
    assert json.loads((tmp_path / "cameras.json").read_text()) == whole[0]["cameras"]
    for own, other in zip(vision.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(other.values, own.values, rtol=1e-9, atol=1e-15)


def test_opensfm_normalised_coordinates(tmp_path: Path, vision: Block) -> None:
    """OpenSfM's own definition: (column + 0.5 - width / 2) / larger side."""
    write_opensfm(tmp_path, vision)
    rows = [line.split("\t") for line in (tmp_path / "tracks.csv").read_text().splitlines()[1:]]
    x = np.array([float(row[3]) for row in rows])
    np.testing.assert_allclose(x * 4608 - 0.5 + 4608 / 2, vision.observations.values[:, 0], atol=1e-9)


@pytest.mark.shared
def test_opensfm_example(shared: Path) -> None:
    """Berlin: the published reconstruction reprojects into its published tracks."""
    folder = shared / "data" / "opensfm-berlin-gcp"
    found = read_reconstruction(folder / "reconstruction_example.json")
    point = {name: k for k, name in enumerate(found.points.names)}
    image = {name: k for k, name in enumerate(found.images.names)}
    own = found.cameras[0]
    miss = []
    for line in (folder / "tracks_example.csv").read_text().splitlines()[1:]:
        name, track, _, x, y = line.split("\t")[:5]
        if track in point and name in image:
            rotation, translation = to_vision(found.images.values[image[name]])
            q = rotation @ found.points.values[point[track]] + translation
            pixel = plane_to_pixel(own.size_px, own.pitch, projected(own, (q * [1, -1, -1])[None]))[0]
            miss.append(pixel - [float(x) * 3264 + 3264 / 2 - 0.5, float(y) * 3264 + 2448 / 2 - 0.5])
    assert len(miss) > 1000
    # A few tenths of a per mille of the image; wrong axes or signs would give hundreds of pixels.
    assert np.sqrt(np.median(np.square(miss))) < 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "no reconstruction"),
        ("[{}]", "lacks the structure"),
        (
            '[{"cameras": {"a": {"projection_type": "spherical", "width": 10, "height": 10}}, "shots": {}}]',
            "spherical",
        ),
        (
            '[{"cameras": {"a": {"projection_type": "brown", "width": 1e12, "height": 10}}, "shots": {}}]',
            "impossible",
        ),
        ('[{"cameras": {"a": 5}, "shots": {}}]', "lacks the structure"),
        ('[{"cameras": {}, "shots": {"i": {"rotation": [0, 0, Infinity]}}}]', "not finite"),
        ('[{"cameras": {}, ', "not valid JSON"),
    ],
)
def test_bad_reconstruction(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(InputMalformedError, match=message):
        read_reconstruction(tmp_path / "r.json")


def test_shots_of_odm(tmp_path: Path) -> None:
    """As ODM's shots.py writes them: rotation to camera axes x right, y down, z forward; places in UTM."""
    rng = np.random.default_rng(4)
    places = np.array([677000.0, 7184000.0, 900.0]) + rng.uniform(-50, 50, (5, 3))
    angles = np.column_stack([np.full(5, 175.0), rng.uniform(-8, 8, 5), [0, 90, 180, 270, 45]])
    turns = Rotation.from_euler("xyz", angles, degrees=True)
    degrees = np.column_stack(
        Transformer.from_crs("EPSG:32722", "EPSG:4326", always_xy=True).transform(*places[:, :2].T)
    )
    features = [
        {
            "type": "Feature",
            "properties": {
                "filename": f"{k}.JPG", "focal": 0.85, "width": 4000, "height": 3000,
                "translation": places[k].tolist(), "rotation": turns[k].as_rotvec().tolist(),
            },
            "geometry": {"type": "Point", "coordinates": [*degrees[k], places[k, 2]]},
        }
        for k in range(5)
    ]  # fmt: skip
    path = tmp_path / "shots.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    given = read_shots(path)
    assert given.block.frame == "EPSG:32722"
    assert given.block.height == "unstated"
    np.testing.assert_allclose(given.block.images.values[:, 3:], places, atol=1e-9)
    # Our own camera axes look backwards along z, with y up.
    seen = matrix_from_angles(given.block.images.values[:, :3])
    np.testing.assert_allclose(seen, np.diag([1.0, -1.0, -1.0]) @ turns.as_matrix(), atol=1e-12)
    path.write_text(json.dumps({"features": [{"properties": {"filename": 1}}]}))
    with pytest.raises(InputMalformedError):
        read_shots(path)
