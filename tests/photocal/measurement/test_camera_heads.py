"""Pictures of cameras on one frame are recognised, and those of one camera are not."""

from __future__ import annotations

from pathlib import Path

import pytest

from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.maker_camera import HeadGroup, recognised_heads


def seen(names: list[str], times: list[str] | None = None) -> HeadGroup | None:
    taken = times or [""] * len(names)
    return recognised_heads(
        {Path(n): ImageFacts(Path(n).name, (100, 80), taken=t) for n, t in zip(names, taken, strict=True)}
    )


def test_the_last_part_of_a_name_tells_the_head() -> None:
    names = [f"IMG_161122_16505{k}_016{k}_{band}.TIF" for k in range(4) for band in ("GRE", "NIR", "RGB")]
    frame = seen(names[:-1])
    assert frame is not None
    assert frame.heads == ("GRE", "NIR", "RGB")
    assert len(set(frame.exposure.values())) == 4
    assert len(frame.head) == 11


def test_folders_of_equal_counts_tell_the_heads() -> None:
    names = [f"{folder}/DSC{100 * k + n:05}.JPG" for k, folder in enumerate("ABCDE") for n in range(3, 9)]
    frame = seen(names)
    assert frame is not None
    assert frame.by == "folders"
    assert [frame.exposure[Path(f"{f}/DSC{n:05}.JPG")] for f, n in (("A", 3), ("C", 203))] == ["00001"] * 2


@pytest.mark.parametrize(
    "names",
    [
        [f"DJI_{k:04}.JPG" for k in range(1, 9)],
        [f"DJI_2023010112000{k}_000{k}_D.JPG" for k in range(1, 9)],
        [f"IMG_{k}.jpg" for k in range(40)],
        ["a.jpg", "b.jpg"],
    ],
)
def test_pictures_of_one_camera_stand_for_themselves(names: list[str]) -> None:
    assert seen(names) is None


def test_two_flights_with_the_same_numbers_are_no_frame() -> None:
    names = [f"{flight}_{k:04}.JPG" for flight in "AB" for k in range(6)]
    times = [f"2024-05-0{1 + 'AB'.index(n[0])}T10:00:0{n[-5]}" for n in names]
    assert seen(names, times) is None


@pytest.mark.parametrize(("metres", "frame"), [(3.0, True), (60.0, False)])
def test_folders_whose_pictures_were_taken_elsewhere_are_two_flights(metres: float, frame: bool) -> None:
    """Without times, or with a clock that nobody has set."""
    pictures = {
        Path(f"{folder}/{folder}{k}.jpg"): ImageFacts(
            f"{folder}{k}.jpg", (100, 80), latitude_deg=52.0 + (10 * k + metres * flight) / 111e3,
            longitude_deg=21.0, altitude_m=100.0, taken="2015-01-01T00:00:00",
        )
        for flight, folder in enumerate(("flight1", "flight2"))
        for k in range(5)
    }  # fmt: skip
    assert (recognised_heads(pictures) is not None) is frame
