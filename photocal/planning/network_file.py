"""A planned network of close-range photos, written down by a person: object, stations, camera, datum.

Precision of a planned network of close-range photos, before anybody has taken one.

The network is adjusted without errors: its covariance is that of targets, camera and stations as planned.
Errors of the model are not in it.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, FiniteFloat, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from photocal.adjustment.network import RELATIONS, Relations
from photocal.base.arrays import Floats, Integers
from photocal.base.checked_toml import Table, read_toml
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.base.files import output_folder, output_picture, write_json, write_rows
from photocal.base.policy import policy
from photocal.base.text_tables import read_table, refuse
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations
from photocal.block.results.adjusted import adjust_network
from photocal.block.results.result import Result
from photocal.findings.document import Paragraph, Section, table, text
from photocal.findings.texts import Catalogue, catalogue
from photocal.geometry.camera import Camera
from photocal.geometry.rotation import angles_from_matrix, turned_left
from photocal.planning.flight import planned_camera
from photocal.planning.simulated_adjustment import SELF_CALIBRATION, visible_rays

_NORMAL = ("nX", "nY", "nZ")
Place = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class PlannedCameraKeys(Table):
    """The camera, what is estimated of it, and how well its images are measured."""

    focal_mm: PositiveFloat
    pixel_um: PositiveFloat
    image_px: tuple[PositiveInt, PositiveInt]
    image_sigma_px: PositiveFloat
    estimate: tuple[str, ...] = SELF_CALIBRATION

    @property
    def planned(self) -> Camera:
        """The camera itself."""
        return planned_camera(self.focal_mm, self.pixel_um, self.image_px, self.estimate)


class FieldKeys(Table):
    """Targets on a plane field about the origin, facing up; every second one stands `relief_m` above it."""

    width_m: PositiveFloat
    height_m: PositiveFloat
    columns: Annotated[int, Field(ge=2, le=1000)]
    rows: Annotated[int, Field(ge=2, le=1000)]
    relief_m: NonNegativeFloat = 0.0


class CylinderKeys(Table):
    """Targets outside on an upright cylinder that stands on the origin, in rings from foot to top."""

    radius_m: PositiveFloat
    height_m: PositiveFloat
    around: Annotated[int, Field(ge=3, le=1000)]
    rings: Annotated[int, Field(ge=2, le=1000)]


class ObjectKeys(Table):
    """The targets; those that a ray meets more slantingly than `steepest_deg` are not measured."""

    field: FieldKeys | None = None
    cylinder: CylinderKeys | None = None
    points: str = ""
    steepest_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 65.0

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(map(bool, (self.field, self.cylinder, self.points))) != 1:
            raise ValueError("give one of field, cylinder and points")
        return self


class RingKeys(Table):
    """Stations on a circle around the target that they look at."""

    radius_m: PositiveFloat
    height_m: FiniteFloat
    count: Annotated[int, Field(ge=1, le=1000)]
    first_deg: FiniteFloat = 0.0
    arc_deg: Annotated[float, Field(gt=0.0, le=360.0)] = 360.0


class StationsKeys(Table):
    """Stations that look at one target; each takes a photo for every roll about its axis."""

    target: Place = (0.0, 0.0, 0.0)
    ring: RingKeys | None = None
    at: tuple[Place, ...] = ()
    rolls_deg: tuple[FiniteFloat, ...] = (0.0,)

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.ring is None) == (not self.at) or not self.rolls_deg:
            raise ValueError("give either ring or at, and one roll at least")
        return self


class DatumKeys(Table):
    """What places the network; nothing: inner constraints over all points."""

    control: tuple[str, ...] = ()
    control_sigma_m: tuple[PositiveFloat, PositiveFloat, PositiveFloat] = (0.001, 0.001, 0.001)
    held: str = ""


class DistanceKeys(Table):
    """A measured distance between two targets."""

    between: tuple[str, str]
    sigma_m: PositiveFloat


class NetworkKeys(Table):
    """The file."""

    camera: PlannedCameraKeys
    object: ObjectKeys
    stations: Annotated[tuple[StationsKeys, ...], Field(min_length=1)]
    datum: DatumKeys = DatumKeys()
    distance: tuple[DistanceKeys, ...] = ()


def read_network(path: Path) -> Block:
    """Read a planned network as a block whose observations have no errors.

    raises InputNotFoundError, InputMalformedError, ConfigurationError: for a file that cannot be one, and for
        photos that see too few targets.
    """
    keys = read_toml(path, NetworkKeys)
    targets, xyz, normal = _targets(keys.object, path)
    names, poses = _photos(keys.stations)
    planned = keys.camera.planned
    image, point, seen = visible_rays(poses, xyz, planned)
    toward = poses[image, 3:] - xyz[point]
    slope = np.einsum("na,na->n", toward, normal[point]) / np.linalg.norm(toward, axis=1)
    keep = ~(slope < np.cos(np.radians(keys.object.steepest_deg)))
    keep &= np.bincount(point[keep], minlength=len(targets))[point] >= 2
    image, point, seen = image[keep], point[keep], seen[keep]
    count = np.bincount(image, minlength=len(names))
    # A photo is oriented by so many points.
    least_points = 4
    if (count < least_points).any():
        worst = int(np.argmin(count))
        raise ConfigurationError(
            f"photo {names[worst]} sees {count[worst]} targets that another photo sees, too",
            "move it nearer to the others or farther from the object, or turn it",
            where=path,
        )
    return Block(
        path.stem,
        "local",
        "",
        "control" if keys.datum.control or keys.datum.held else "free",
        (planned,),
        Images(names, np.zeros(len(names), dtype=np.int64), poses, _held(keys.datum.held, names, path)),
        *_observed(keys, targets, xyz, (image, point, seen), path),
    )


def _observed(
    keys: NetworkKeys,
    targets: tuple[str, ...],
    xyz: Floats,
    rays: tuple[Integers, Integers, Floats],
    path: Path,
) -> tuple[Any, ...]:
    """Points, observations and what follows them in a block."""
    image, point, seen = rays
    used, place = np.unique(point, return_inverse=True)
    number = {targets[k]: n for n, k in enumerate(used.tolist())}
    ends = [name for one in keys.distance for name in one.between]
    for name in (*keys.datum.control, *ends):
        if name not in number:
            what = "is seen by less than two photos" if name in targets else "is not on the object"
            raise ConfigurationError(f"target {name} {what}", "name another one", where=path)
    control = np.array([number[name] for name in keys.datum.control], dtype=np.int64)
    sigma = np.full((len(used), 3), np.inf)
    sigma[control] = keys.datum.control_sigma_m
    role = np.full(len(used), ROLES.index("tie"))
    role[control] = ROLES.index("control")
    precision = keys.camera.image_sigma_px * keys.camera.pixel_um * 1e-3
    first, second = np.array([number[name] for name in ends], dtype=np.int64).reshape(-1, 2).T
    xyz = xyz[used]
    tapes = Relations(
        np.full(len(first), list(RELATIONS).index("distance")),
        first,
        second,
        np.linalg.norm(xyz[second] - xyz[first], axis=1),
        np.array([one.sigma_m for one in keys.distance]),
    )
    return (
        ObjectPoints(tuple(number), xyz, sigma, role),
        Observations("mm", "photo", image, place, seen, np.full(seen.shape, precision)),
        (),
        (),
        tapes,
    )


def _targets(keys: ObjectKeys, path: Path) -> tuple[tuple[str, ...], Floats, Floats]:
    """Targets of the object, named row by row or ring by ring: names, places, and where they face, (n, 3).

    A normal of NaN is seen from everywhere.
    """
    if (body := keys.field or keys.cylinder) is not None:
        across, up = (body.columns, body.rows) if isinstance(body, FieldKeys) else (body.around, body.rings)
        j, i = (axis.ravel() for axis in np.meshgrid(np.arange(across), np.arange(up)))
        names = tuple(f"{b + 1}.{a + 1}" for a, b in zip(j.tolist(), i.tolist(), strict=True))
        if isinstance(body, FieldKeys):
            x = (j / (across - 1) - 0.5) * body.width_m
            y = (i / (up - 1) - 0.5) * body.height_m
            xyz = np.column_stack([x, y, body.relief_m * ((i + j) % 2)])
            return names, xyz, np.tile([0.0, 0.0, 1.0], (len(xyz), 1))
        angle = 2 * np.pi * j / across
        normal = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
        xyz = body.radius_m * normal
        xyz[:, 2] = body.height_m * i / (up - 1)
        return names, xyz, normal
    table = read_table(path.parent / keys.points, ("point", "X", "Y", "Z"), _NORMAL)
    names = table.unique_names("point")
    normal = np.full((len(names), 3), np.nan)
    if any(map(table.has, _NORMAL)):
        if not all(map(table.has, _NORMAL)):
            raise InputMalformedError(
                "has an incomplete normal", "give nX, nY and nZ", where=path.parent / keys.points
            )
        normal = table.matrix(_NORMAL)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        refuse(table, length[:, 0] == 0.0, "the normal has no length", "it points away from the surface")
        normal = normal / length
    return names, table.matrix("XYZ"), normal


def _photos(groups: tuple[StationsKeys, ...]) -> tuple[tuple[str, ...], Floats]:
    """Names and orientations of all photos, shape (n, 6): station 3 has photos 3.1, 3.2 where it rolls."""
    names, poses, number = [], [], 0
    for group in groups:
        target = np.array(group.target)
        places = np.array(group.at, dtype=np.float64).reshape(-1, 3)
        if group.ring is not None:
            ring = group.ring
            # A whole circle does not come back to its first station.
            steps = ring.count if ring.arc_deg == 360.0 else max(ring.count - 1, 1)
            angle = np.radians(ring.first_deg + ring.arc_deg * np.arange(ring.count) / steps)
            around = np.column_stack([np.cos(angle), np.sin(angle)]) * ring.radius_m
            places = target + np.column_stack([around, np.full(ring.count, ring.height_m)])
        for place in places:
            number += 1
            for k, roll in enumerate(group.rolls_deg):
                names.append(f"{number}.{k + 1}" if len(group.rolls_deg) > 1 else f"{number}")
                poses.append([*angles_from_matrix(_looking(place, target, np.radians(roll))), *place])
    return tuple(names), np.array(poses)


def _looking(place: Floats, target: Floats, roll: float) -> Floats:
    """Turn from object to camera axes of a photo that looks at a target, its x axis level without roll."""
    back = place - target
    if not back.any():
        raise ConfigurationError(
            f"the station {place.tolist()} is the same as its target", "move station or target"
        )
    back = back / np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    # Straight down the top of the photo is north.
    right = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(right) < 1e-9 else right / np.linalg.norm(right)
    upright = np.stack([right, np.cross(back, right), back])
    return np.asarray(turned_left(roll) @ upright)


def _held(held: str, names: tuple[str, ...], path: Path) -> Floats:
    sigma = np.full((len(names), 6), np.inf)
    if held:
        if held not in names:
            raise ConfigurationError(
                f"no photo {held} is planned", f"they are {', '.join(names)}", where=path
            )
        sigma[names.index(held)] = 0.0
    return sigma


@dataclass(frozen=True)
class NetworkPlan:
    """A planned network and its adjustment.

    block: its observations have no errors.
    """

    block: Block
    result: Result

    @property
    def camera(self) -> Camera:
        """The adjusted camera."""
        return next(iter(self.result.cameras.values()))

    def correlations(self) -> list[tuple[str, str, float]]:
        """Strong correlations of camera parameters, see the policy, the largest first."""
        names = self.camera.free
        r = self.camera.correlation_of(names)
        pairs = zip(*np.triu_indices(len(names), 1), strict=True)
        found = [
            (names[a], names[b], float(r[a, b]))
            for a, b in pairs
            if abs(r[a, b]) >= policy.strong_correlation
        ]
        return sorted(found, key=lambda one: -abs(one[2]))

    def figures(self) -> dict[str, Any]:
        """Give all figures as a JSON value; sigmas of points and stations are root mean squares."""
        block, result, camera = self.block, self.result, self.camera
        sigma, seen = result.points.sigma, block.observations
        worst = int(np.argmax(np.linalg.norm(sigma, axis=1)))
        mean = float(np.sqrt(np.mean(sigma**2)))
        away = np.linalg.norm(block.images.values[seen.image, 3:] - block.points.values[seen.point], axis=1)
        number = float(away.mean()) / (camera.value("c") * 1e-3)
        extent = float(np.linalg.norm(np.ptp(block.points.values, axis=0)))
        pose = np.sqrt(np.mean(np.nan_to_num(result.images.sigma) ** 2, axis=0))
        return {
            "schema": "photocal.network-plan/1",
            "photos": len(block.images.names),
            "stations": len(np.unique(block.images.values[:, 3:], axis=0)),
            "points": len(block.points.names),
            "rays": len(seen.image),
            "rays_per_point": {
                "least": int(result.points.rays.min()),
                "mean": float(result.points.rays.mean()),
            },
            "degrees_of_freedom": result.degrees_of_freedom,
            "datum": block.datum,
            "distances": len(block.relations.values),
            "sigma_m": dict(zip("xyz", np.sqrt(np.mean(sigma**2, axis=0)).tolist(), strict=True)),
            "mean_sigma_m": mean,
            "worst": {"point": result.points.names[worst], "sigma_m": sigma[worst].tolist()},
            "one_part_in": extent / mean,
            "scale_number": number,
            "design_factor": mean / (number * float(seen.sigma[0, 0]) * 1e-3),
            "station_sigma": {"place_m": pose[3:].tolist(), "angles_deg": np.degrees(pose[:3]).tolist()},
            "camera": [
                {"name": name, "sigma": camera.sigma_of(name), "sigma_px": self._pixels(name)}
                for name in camera.free
            ],
            "correlations": [
                dict(zip(("first", "second", "r"), one, strict=True)) for one in self.correlations()
            ],
        }

    def _pixels(self, name: str) -> float | None:
        """Sigma of a length in the image, px; None for a coefficient."""
        return self.camera.sigma_of(name) / self.camera.pitch[0] if name in ("c", "x0", "y0") else None

    def __repr__(self) -> str:
        """Say it for people."""
        return self.text(catalogue("en"))

    def text(self, say: Catalogue) -> str:
        """Give it as a text in a language."""
        made = self.figures()
        rays, worst, station = made["rays_per_point"], made["worst"], made["station_sigma"]
        places, farthest = (
            say.row((1e3 * value for value in one), ".3f")
            for one in (made["sigma_m"].values(), worst["sigma_m"])
        )
        counts = {key: made[key] for key in ("photos", "stations", "rays")} | rays
        of = {"worst": worst["point"], "figures": places, "farthest": farthest, "parts": made["one_part_in"]}
        weakest = {"place": 1e3 * max(station["place_m"]), "angle": max(station["angles_deg"])}
        freedom, datum = made["degrees_of_freedom"], say.stored(made["datum"])
        story = (
            say.told("network.head", **counts, points=made["points"], freedom=freedom, datum=datum),
            say.told("network.targets", **of),
            say.told("network.design", factor=made["design_factor"], scale=made["scale_number"]),
            say.told("network.stations", **weakest),
        )
        pieces: list[Any] = [Paragraph("\n".join(story))]
        cells = [
            (one["name"], say.row([one["sigma"]], ".3g"), "" if px is None else say.row([px], ".3f"))
            for one in made["camera"]
            for px in [one["sigma_px"]]
        ]
        if cells:
            pieces.append(table(say("network.camera"), say("network.camera_heads").split("|"), cells))
        if high := [(f"{a}, {b}", say.row([r], "+.3f")) for a, b, r in self.correlations()]:
            title = say.told("network.correlations", limit=policy.strong_correlation)
            pieces.append(table(title, say("network.correlations_heads").split("|"), high))
        return text([Section("", tuple(pieces))])

    def write(self, folder: Path) -> tuple[str, ...]:
        """Write figures, the block, its adjustment, correlations and a picture; raises OutputError."""
        with output_folder(folder) as aside:
            write_json(aside / "network.json", self.figures())
            names = self.camera.free
            matrix = self.camera.correlation_of(names).tolist()
            rows = [(name, *(f"{r:.4f}" for r in row)) for name, row in zip(names, matrix, strict=True)]
            write_rows(aside / "correlations.csv", ("parameter", *names), rows)
            self._draw(aside / "network.png")
            self.block.write(aside / "block")
            self.result.write(aside / "run")
        return "network.json", "network.png", "correlations.csv", "block/", "run/"

    def _draw(self, path: Path) -> None:
        """Draw stations, rays and targets from above and from the side; colour is the sigma of a target."""
        stations, targets = self.block.images.values[:, 3:], self.block.points.values
        seen = self.block.observations
        length = 1e3 * np.linalg.norm(self.result.points.sigma, axis=1)
        # Rays that are drawn of a photo.
        rays_drawn = 12
        with output_picture(path, (8.0, 4.4)) as figure:
            for place, (across, up) in enumerate(((0, 1), (0, 2))):
                axes = figure.add_subplot(1, 2, place + 1)
                for photo in range(len(stations)):
                    of = seen.point[seen.image == photo]
                    ends = targets[of[:: max(len(of) // rays_drawn, 1)]]
                    for end in ends:
                        axes.plot(
                            *np.stack([stations[photo], end])[:, [across, up]].T, c="0.85", lw=0.3, zorder=0
                        )
                axes.plot(stations[:, across], stations[:, up], "k^", ms=4)
                drawn = axes.scatter(targets[:, across], targets[:, up], c=length, s=9, cmap="viridis")
                axes.set_aspect("equal", adjustable="datalim")
                axes.set_xlabel(f"{'XYZ'[across]}, m")
                axes.set_ylabel(f"{'XYZ'[up]}, m")
            figure.colorbar(drawn, ax=figure.axes, label="sigma of a target, mm", shrink=0.8)


def plan_network(path: str | Path) -> NetworkPlan:
    """Predict the precision of a close-range network before the photos are taken.

    Parameters
    ----------
    path
        TOML file: camera, object, stations, datum, distances (configs/networks has examples).

    Returns
    -------
    NetworkPlan
        The planned block and its adjustment, from which sigmas and correlations follow.

    Raises
    ------
    ConfigurationError
        For a network that cannot be built.
    IllPosedError
        For one that its observations do not determine.
    InputNotFoundError, InputMalformedError
        For a file or a table of points that cannot be read.

    Examples
    --------
    >>> import photocal
    >>> planned = photocal.plan_network("test-field.toml")
    >>> planned.figures()["photos"]
    20
    """
    block = read_network(Path(path))
    return NetworkPlan(block, adjust_network(block))
