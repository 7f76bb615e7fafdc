"""The TOML file that describes an experiment."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt

from acquire.checked_toml import Table, read_toml
from drivers.errors import ConfigurationError
from photocal.block.model import Block
from photocal.geometry.camera import Camera
from photocal.georeferencing.experiment import (
    Experiment,
    Pattern,
    Use,
    spread_points,
)
from photocal.georeferencing.methods import Method, ground_points
from photocal.georeferencing.simulated import Degradation


class _Noise(Table):
    position_m: PositiveFloat
    attitude_deg: PositiveFloat
    seed: NonNegativeInt = 0


class _Interior(Table):
    cameras: str
    camera: str = ""
    use: tuple[Literal["weighted", "fixed"], ...] = ("weighted", "fixed")


class _Pattern(Table):
    name: str
    points: list[str] = Field(min_length=1)


class _Control(Table):
    pattern: tuple[_Pattern, ...] = ()
    counts: tuple[PositiveInt, ...] = ()
    leave_one_out: bool = False


class _File(Table):
    block: str
    methods: tuple[Method, ...] = ("integrated",)
    confidence: float = Field(default=0.95, gt=0.0, lt=1.0)
    simulated_direct: _Noise | None = None
    interior: _Interior | None = None
    control: _Control = _Control()


def read_experiment(
    path: Path,
    read_block: Callable[[Path], Block],
    read_interiors: Callable[[Path], tuple[Camera, ...]],
) -> Experiment:
    """Read an experiment.

    raises InputNotFoundError: when it does not exist.
    raises ConfigurationError: for wrong keys or values, and for points that are not in the block.
    """
    asked = read_toml(path, _File)
    block = read_block(path.parent / asked.block)
    interiors: tuple[Camera, ...] = ()
    uses: tuple[Use, ...] = ()
    camera = 0
    if asked.interior is not None:
        interiors, uses = read_interiors(path.parent / asked.interior.cameras), tuple(asked.interior.use)
        camera = _camera(block, asked.interior.camera, path)
        _require_fitting(block.cameras[camera], interiors, path)
    noise = asked.simulated_direct
    return Experiment(
        block,
        tuple(asked.methods),
        interiors,
        uses,
        _patterns(asked.control, block, path),
        asked.control.leave_one_out,
        None if noise is None else Degradation(noise.position_m, math.radians(noise.attitude_deg)),
        0 if noise is None else noise.seed,
        asked.confidence,
        camera,
    )


def _camera(block: Block, name: str, path: Path) -> int:
    """Which camera of the block gets the interior orientations."""
    names = [own.id for own in block.cameras]
    if not name and len(names) == 1:
        return 0
    if name not in names:
        said = f"camera {name} is not in the block" if name else "the block has several cameras"
        raise ConfigurationError(
            said, where=path, remedy=f'write camera = "..." in [interior]: {", ".join(names)}'
        )
    return names.index(name)


def _require_fitting(own: Camera, interiors: tuple[Camera, ...], path: Path) -> None:
    for one in interiors:
        if one.unit != own.unit or one.size_px != own.size_px:
            raise ConfigurationError(
                f"interior orientation {one.id} is of another image size or unit than camera {own.id}",
                where=path,
                remedy="give calibrations of the block's own camera",
            )


def _patterns(control: _Control, block: Block, path: Path) -> tuple[Pattern, ...]:
    index = {name: k for k, name in enumerate(block.points.names)}
    surveyed = np.isfinite(block.points.sigma).any(axis=1) | block.points.of_role("control")
    patterns = []
    for pattern in control.pattern:
        for name in pattern.points:
            if name not in index:
                raise ConfigurationError(
                    f"point {name} of pattern {pattern.name} is not in the block",
                    where=path,
                    remedy="name points of points.csv",
                )
            if not surveyed[index[name]]:
                raise ConfigurationError(
                    f"point {name} of pattern {pattern.name} has no sigma, so it cannot be control",
                    where=path,
                    remedy="give it sX, sY, sZ in points.csv",
                )
        patterns.append((pattern.name, np.array([index[n] for n in pattern.points])))
    usable = ground_points(block)
    usable = usable[surveyed[usable]]
    patterns += [(f"{n} control", spread_points(block, usable, n)) for n in control.counts]
    return tuple(patterns)
