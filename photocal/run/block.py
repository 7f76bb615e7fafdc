"""Stage `block`: what was measured in the images and what GNSS and inertial unit observed, in one folder."""

import csv
import json
import shutil
from pathlib import Path
from typing import Any

from photocal.base.errors import InputNotFoundError
from photocal.base.progress import Progress
from photocal.block.setup import MountingKeys
from photocal.project import Project
from photocal.run.stage import Stage

_FROM_EXPOSURES = ("positions.csv", "attitudes.csv")


def block_stage(project: Project, exposures: Path | None, measurements: Path) -> Stage:
    """Describe the stage, which follows those whose folders are given; exposures None without a flight."""
    from photocal.block.folder import read_block
    from photocal.run.project_checks import check_rays

    distances, bent = project.control.distances, project.contents.project.refraction

    def make(folder: Path, _: Progress) -> None:
        for path in sorted(measurements.iterdir()):
            if path.name != "stage.json":
                shutil.copyfile(path, folder / path.name)
        if distances is not None:
            shutil.copyfile(distances, folder / "distances.csv")
        if bent is not None:
            text = (folder / "block.toml").read_text(encoding="utf-8")
            with_choice = text.replace("[block]\n", f"[block]\nrefraction = {bent}\n", 1)
            (folder / "block.toml").write_text(with_choice, encoding="utf-8")
        if exposures is None:
            return
        with (folder / "images.csv").open(newline="", encoding="utf-8") as stream:
            images = {row["image"] for row in csv.DictReader(stream)}
        for name in _FROM_EXPOSURES:
            _copy_rows(exposures / name, folder / name, images)
        setup = folder / "block.toml"
        keys = project.rig.mounting().model_copy(update=_shared_by_the_flight(exposures))
        text = setup.read_text(encoding="utf-8") + "\n" + mounting_text(keys)
        setup.write_text(text, encoding="utf-8")
        check_rays(read_block(folder), project.control.points)

    chosen: dict[str, Any] = {} if bent is None else {"refraction": bent}
    inputs = {} if distances is None else {"distances": distances}
    if exposures is None:
        return Stage("block", "the block", make, inputs, chosen, (measurements,))
    settings = {"rig": project.rig.mounting().model_dump(mode="json"), **chosen}
    return Stage("block", "the block", make, inputs, settings, (exposures, measurements))


def _shared_by_the_flight(exposures: Path) -> dict[str, Any]:
    """What the errors of all positions have in common, as keys of `[mounting]`; none without PPK."""
    common = json.loads((exposures / "exposures.json").read_text(encoding="utf-8")).get("common")
    if common is None:
        return {}
    return {
        "flight_shift_sigma_m": tuple(common["shift_sigma_m"]),
        "height_scale_sigma": common["zenith_scale_sigma"],
        "height_scale_from_m": common["base_height_m"],
    }


def _copy_rows(source: Path, target: Path, images: set[str]) -> None:
    """Copy the rows of images that take part, for some had no usable points; a table without rows is none."""
    with source.open(newline="", encoding="utf-8") as given:
        reader = csv.DictReader(given)
        rows = [row for row in reader if row["image"] in images]
    if not rows:
        return
    with target.open("w", newline="", encoding="utf-8") as taken:
        writer = csv.DictWriter(taken, reader.fieldnames or (), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def given_block_stage(source: Path) -> Stage:
    """Describe the stage that takes a ready block folder over."""

    def make(folder: Path, _: Progress) -> None:
        if not (source / "block.toml").is_file():
            raise InputNotFoundError(
                "has no block.toml", "name a block folder in [measurements]", where=source
            )
        shutil.copytree(source, folder, dirs_exist_ok=True)

    return Stage("block", "the block", make, {"block": source})


def mounting_text(keys: MountingKeys) -> str:
    """Write the section `[mounting]` of a `block.toml`."""
    values = keys.model_dump(mode="json", exclude_unset=True)
    return "[mounting]\n" + "".join(f"{name} = {json.dumps(value)}\n" for name, value in values.items())
