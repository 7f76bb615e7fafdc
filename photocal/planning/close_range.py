"""Precision of a planned network of close-range photos, before anybody has taken one.

The network is adjusted without errors: its covariance is that of targets, camera and stations as planned.
Errors of the model are not in it.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.files import output_folder, output_picture, write_json, write_rows
from photocal.block.model import Block
from photocal.findings.document import Paragraph, Section, table, text
from photocal.geometry.camera import Camera
from photocal.planning.network_file import read_network
from photocal.results.adjusted import adjust_network
from photocal.results.result import Result

# Correlations from here on are listed one by one.
HIGH = 0.8
# Rays that are drawn of a photo.
_DRAWN = 12


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
        """Correlations of camera parameters of at least `HIGH`, the largest first."""
        names = self.camera.free
        r = self.camera.correlation_of(names)
        pairs = zip(*np.triu_indices(len(names), 1), strict=True)
        found = [(names[a], names[b], float(r[a, b])) for a, b in pairs if abs(r[a, b]) >= HIGH]
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
            "sigma_m": dict(zip("xyz", _rms(sigma), strict=True)),
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

    def __str__(self) -> str:
        """Say it for people."""
        made = self.figures()
        rays, worst, station = made["rays_per_point"], made["worst"], made["station_sigma"]
        places, farthest = (
            " ".join(f"{1e3 * value:.3f}" for value in one)
            for one in (made["sigma_m"].values(), worst["sigma_m"])
        )
        story = (
            f"{made['photos']} photos at {made['stations']} stations, {made['points']} targets, "
            f"{made['rays']} rays ({rays['least']} to a target at least, {rays['mean']:.1f} on average), "
            f"{made['degrees_of_freedom']} degrees of freedom, datum {made['datum']}\n"
            f"targets: sigma X Y Z {places} mm (root mean square), worst {worst['point']}: {farthest} mm; "
            f"1 part in {made['one_part_in']:.0f}\n"
            f"sigma = K M s: K {made['design_factor']:.2f} at the mean photo scale "
            f"1:{made['scale_number']:.0f}\n"
            f"stations: {1e3 * max(station['place_m']):.2f} mm, {max(station['angles_deg']):.4f} deg "
            "(the axis that is known least)"
        )
        pixels = ((one, one["sigma_px"]) for one in made["camera"])
        cells = [
            (one["name"], f"{one['sigma']:.3g}", "" if px is None else f"{px:.3f}") for one, px in pixels
        ]
        pieces: list[Any] = [Paragraph(story)]
        if cells:
            pieces.append(
                table("camera as it will be known", ("parameter", "sigma (powers of mm)", "px"), cells)
            )
        if high := [(f"{a}, {b}", f"{r:+.3f}") for a, b, r in self.correlations()]:
            pieces.append(table(f"correlations of {HIGH:g} and more", ("parameters", "r"), high))
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
        with output_picture(path, (8.0, 4.4)) as figure:
            for place, (across, up) in enumerate(((0, 1), (0, 2))):
                axes = figure.add_subplot(1, 2, place + 1)
                for photo in range(len(stations)):
                    of = seen.point[seen.image == photo]
                    ends = targets[of[:: max(len(of) // _DRAWN, 1)]]
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


def plan_network(path: Path) -> NetworkPlan:
    """Adjust a planned network that a TOML file describes.

    raises ConfigurationError: for a network that its observations do not determine, and as of `read_network`.
    """
    block = read_network(path)
    return NetworkPlan(block, adjust_network(block))


def _rms(values: Floats) -> list[float]:
    return [float(v) for v in np.sqrt(np.mean(values**2, axis=0))]
