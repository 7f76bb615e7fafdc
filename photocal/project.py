"""`PROJECT.toml`: everything that a flight is processed from, named in one file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from acquire.checked_toml import read_toml
from drivers.errors import ConfigurationError
from photocal.block.camera_setup import make_camera
from photocal.geometry.camera import Camera
from photocal.project_tables import Contents, Control, Flight, Images, Rig

Part = TypeVar("Part")


@dataclass(frozen=True)
class Project:
    """A project file that was read and checked.

    path: the file.
    contents: its tables; paths are taken from the folder of the file.
    cameras: of `[[camera]]`.
    """

    path: Path
    contents: Contents
    cameras: tuple[Camera, ...]

    @property
    def name(self) -> str:
        """Name of the project."""
        return self.contents.project.name

    @property
    def crs(self) -> str:
        """System of results and control: a name such as "EPSG:31982", or "local"."""
        return self.contents.project.crs

    @property
    def height(self) -> str:
        """Kind of the heights in it: ellipsoidal, orthometric or local."""
        return self.contents.project.height

    @property
    def output(self) -> Path:
        """Work folder, with one folder for each stage of `photocal run`."""
        return self.contents.project.output

    @property
    def flight(self) -> Flight:
        """`[flight]`; ConfigurationError without it, as for all sections below."""
        return self._needed(self.contents.flight, "[flight]")

    @property
    def images(self) -> Images:
        """`[images]`."""
        return self._needed(self.contents.images, "[images]")

    @property
    def picture_folder(self) -> Path:
        """Folder of the pictures."""
        return self._needed(self.images.folder, "folder in [images]")

    @property
    def rig(self) -> Rig:
        """`[rig]`."""
        return self._needed(self.contents.rig, "[rig]")

    @property
    def control(self) -> Control:
        """`[control]`; empty without it."""
        return self.contents.control or Control()

    @property
    def camera(self) -> Camera:
        """The only camera."""
        if len(self.cameras) > 1:
            raise ConfigurationError(
                f"has {len(self.cameras)} cameras, one was expected",
                where=self.path,
                remedy="keep one [[camera]]",
            )
        return self._needed(self.cameras[0] if self.cameras else None, "[[camera]]")

    def _needed(self, part: Part | None, name: str) -> Part:
        if part is None:
            raise ConfigurationError(f"{name} is missing", where=self.path, remedy="add it")
        return part


def read_project(path: Path) -> Project:
    """Read and check a project file.

    raises InputNotFoundError: when there is no such file.
    raises ConfigurationError: for what is not TOML, an unknown key, a missing one, or an impossible value.
    """
    contents = read_toml(path, Contents, {"folder": path.parent})
    cameras = [make_camera(keys, path) for keys in contents.camera]
    # Nobody said: the adjustment of the flight will tell.
    cameras = [
        replace(camera, shutter="unknown") if keys.shutter is None and not camera.rolling else camera
        for keys, camera in zip(contents.camera, cameras, strict=True)
    ]
    return Project(path, contents, tuple(cameras))
