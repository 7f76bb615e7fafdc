"""A flight as a block folder in the local frame, its plain files, and what the surveyor notes down.

Every observation of the folder carries just the noise that it states.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from acquire.simulate.world.configuration import FlightConfiguration
from acquire.simulate.world.exposures import antenna_at, antenna_velocity
from acquire.simulate.world.observations import MeasuredPoints, kept_images
from acquire.simulate.world.place import LEAP_S
from acquire.simulate.world.world import World
from photocal.base.arrays import Floats, Integers, picked
from photocal.base.codec import toml_text
from photocal.base.errors import ConfigurationError

# Format and values of each column, by its name.
Columns = dict[str, tuple[str, Iterable[Any]]]


def write_block(world: World, observed: MeasuredPoints, folder: Path) -> None:
    """Write the block folder of a flight; a fault that only shows in streams is refused."""
    if world.has("cycle_slips"):
        raise ConfigurationError(
            'level = "block" cannot simulate cycle slips', 'take level = "observations" or "pictures"'
        )
    folder.mkdir(parents=True)
    kept = np.flatnonzero(kept_images(world))
    names = np.array(world.exposures.names, dtype=object)
    positions, attitudes = _navigation(world, kept)
    write_table(folder / "positions.csv", {"image": ("", names[kept]), **positions})
    event = world.exposures.event_s[kept]
    begin, end = telemetry_gap(world)
    heard = np.asarray((event < begin) | (event >= end))
    write_table(
        folder / "attitudes.csv",
        {"image": ("", names[kept][heard]), **{k: (f, v[heard]) for k, (f, v) in attitudes.items()}},
    )
    blank = np.full(len(kept), np.nan)
    write_table(
        folder / "images.csv",
        {
            "image": ("", names[kept]),
            "camera": ("", [world.configuration.camera.id] * len(kept)),
            **dict.fromkeys(("X", "Y", "Z", "omega", "phi", "kappa"), ("", blank)),
        },
    )
    seen = tuple(observed.names[k] for k in np.unique(observed.point).tolist())
    write_targets(world, world.targets.surveyed_m, folder / "points.csv", seen)
    write_observations(world, observed, folder / "observations.csv")
    (folder / "block.toml").write_text(_setup(world), encoding="utf-8")


def write_observations(world: World, observed: MeasuredPoints, path: Path) -> None:
    """Write `observations.csv`."""
    names = np.array(world.exposures.names, dtype=object)
    points = np.array(observed.names, dtype=object)
    write_table(
        path,
        {
            "image": ("", names[observed.image]),
            "point": ("", points[observed.point]),
            "x": (".4f", observed.pixels[:, 0]),
            "y": (".4f", observed.pixels[:, 1]),
            "sx": ("g", observed.sigma_px),
            "sy": ("g", observed.sigma_px),
        },
    )


def _navigation(
    world: World, kept: Integers
) -> tuple[dict[str, tuple[str, Floats]], dict[str, tuple[str, Floats]]]:
    """Give positions of the antenna and attitudes at the events, with noise."""
    rig, random = world.configuration.rig, world.random("sky")
    late = LEAP_S if world.has("event_time_base") else 0.0
    event = world.exposures.event_s[kept] - late
    position = antenna_at(world.motion, world.rig, event)
    position = position + random.standard_normal(position.shape) * rig.position_sigma_m
    position = position + world.base_error_m
    position[:, 2] -= world.antenna_height_error_m
    velocity = antenna_velocity(world.motion, world.rig, event)
    angles = np.degrees(world.motion.angles(event))
    angles = angles + random.standard_normal(angles.shape) * rig.attitude_sigma_deg
    positions = {
        **columns_of("X Y Z", position, ".5f"),
        **columns_of("sX sY sZ", np.tile(rig.position_sigma_m, (len(kept), 1)), "g"),
        **columns_of("vX vY vZ", velocity, ".5f"),
    }
    attitudes = {
        **columns_of("roll pitch yaw", angles, ".6f"),
        **columns_of("sroll spitch syaw", np.tile(rig.attitude_sigma_deg, (len(kept), 1)), "g"),
    }
    return positions, attitudes


def telemetry_gap(world: World) -> tuple[float, float]:
    """Give when telemetry is lost: in the middle of the survey, or never."""
    if not world.has("telemetry_gap"):
        return np.inf, np.inf
    middle = float(np.median(world.exposures.event_s))
    half = world.configuration.fault_sizes.gap_s / 2.0
    return middle - half, middle + half


def write_targets(world: World, coordinates: Floats, path: Path, names: Sequence[str]) -> None:
    """Write a table of points: targets as they were surveyed (n, 3), all others as tie points."""
    sigma = ",".join(f"{s:g}" for s in world.configuration.targets.sigma_m)
    surveyed = zip(
        world.targets.names, noted_control(world, coordinates)[0], world.targets.roles, strict=True
    )
    cells = {name: f"{','.join(texts)},{sigma},{role}" for name, texts, role in surveyed}
    lines = [f"{name},{cells.get(name, ',,,,,,tie')}" for name in names]
    path.write_text("\n".join(["point,X,Y,Z,sX,sY,sZ,role", *lines]) + "\n", encoding="utf-8")


def camera_keys(configuration: FlightConfiguration) -> dict[str, Any]:
    """Give the `[[camera]]` of block and project files: it knows what the makers say, no more."""
    camera = configuration.camera
    return {
        "id": camera.id,
        "model": "brown-ideal",
        "unit": "mm",
        "size_px": camera.size_px,
        "pitch_mm": camera.pitch_mm,
        "parameters": {"c": camera.nominal_mm},
        "estimate": camera.estimate,
        "affinity": "after",
    }


def _setup(world: World) -> str:
    given = world.configuration
    rig = given.rig
    return toml_text(
        {
            "block": {"name": given.name, "frame": "local", "height": "local", "datum": "control"},
            "observations": {"unit": "px", "axes": "pixel", "sigma": given.observing.sigma_px},
            "camera": [camera_keys(given)],
            "mounting": {
                "lever_arm_m": world.noted_arm_m.tolist(),
                "lever_arm_sigma_m": rig.camera_to_antenna_sigma_m,
                **picked(rig, "boresight_deg", "boresight_sigma_deg", "time_offset_s", "time_offset_sigma_s"),
                "camera_axes": ["right", "forward", "up"],
            },
        }
    )


def columns_of(names: str, values: Floats, form: str) -> dict[str, tuple[str, Floats]]:
    """Give the columns of an array (n, k) of one format; their names stand between blanks."""
    return {name: (form, column) for name, column in zip(names.split(), values.T, strict=True)}


def write_table(path: Path, columns: Columns) -> None:
    """Write a CSV file; `columns`: format of each value and the values; NaN becomes an empty cell."""
    cells = [
        [
            "" if isinstance(value, (float, np.floating)) and np.isnan(value) else format(value, form)
            for value in values
        ]
        for form, values in columns.values()
    ]
    lines = [",".join(columns), *(",".join(row) for row in zip(*cells, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def noted_control(world: World, coordinates: Floats) -> tuple[list[tuple[str, ...]], str]:
    """Write down the surveyed coordinates of the targets (n, 3), in the system of the site.

    returns: three texts for each target, and the name of the one with swapped digits, empty for none.
    """
    given = world.configuration
    texts = [tuple(f"{value:.4f}" for value in row) for row in coordinates.tolist()]
    if not world.has("control_digits"):
        return texts, ""
    control = [k for k, role in enumerate(world.targets.roles) if role == "control"]
    row = control[int(world.random("faults").integers(len(control)))]
    added, wrong = given.fault_sizes.control_m, _swapped(texts[row])
    if any(added):
        wrong = tuple(f"{float(text) + more:.4f}" for text, more in zip(texts[row], added, strict=True))
    texts[row] = wrong
    return texts, world.targets.names[row]


def _swapped(texts: tuple[str, ...]) -> tuple[str, ...]:
    """Swap two neighbouring digits of a coordinate, the last ones that make half a metre."""
    # A smaller typing error would pass for noise.
    least_slip_m = 0.5
    for axis, text in enumerate(texts):
        for place in range(len(text) - 2, -1, -1):
            pair = text[place : place + 2]
            changed = text[:place] + pair[::-1] + text[place + 2 :]
            if pair.isdigit() and abs(float(changed) - float(text)) >= least_slip_m:
                return (*texts[:axis], changed, *texts[axis + 1 :])
    # All digits of all coordinates alike: a metre is missed instead.
    return (f"{float(texts[0]) + 1:.4f}", *texts[1:])
