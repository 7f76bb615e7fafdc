"""A PPK run: its trajectory, and what a person judges it by: figures, sentences and a plot."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, as_plain, picked
from photocal.base.codec import object_of, parsed_json
from photocal.base.files import output_folder, output_picture, write_json
from photocal.base.geodesy import geodetic
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_json, finding_text, findings_of, plain
from photocal.navigation.base_frame import BaseFrame
from photocal.navigation.common_errors import CommonErrors, common_text
from photocal.navigation.engine import ENGINE, FIXED, EngineSolution, Mode, ProcessingOptions
from photocal.navigation.fix_validation import ValidatedFixes
from photocal.navigation.ppk_inputs import Inputs
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import Trajectory, write_trajectory

FIGURES = "ppk.json"
_REMEDY = "compute the PPK again"


@dataclass(frozen=True, repr=False)
class Ppk:
    """A trajectory from raw observations, and the figures by which it is judged.

    Attributes
    ----------
    inputs, options, mode
        What it was computed from, and how.
    combined
        The engine's own positions, quality and sigmas.
    judgement
        Which of its fixes hold; None of a rover that stood still.
    trajectory
        Positions as judged.
    base_off_code_m : array, shape (3,)
        The base's position less its own code solution, east, north, up, m.
    base_gaps_s
        Begin and length of the gaps of the base within the rover's time, longest first.
    replaced
        Number of epochs at which the engine's combination lay apart from both directions.
    common
        Errors that all positions share.
    """

    inputs: Inputs
    options: ProcessingOptions
    mode: Mode
    combined: EngineSolution
    judgement: ValidatedFixes | None
    trajectory: Trajectory
    base_off_code_m: Floats
    base_gaps_s: list[tuple[GpsTime, float]]
    replaced: int
    common: CommonErrors

    @cached_property
    def figures(self) -> dict[str, Any]:
        """As in `ppk.json`: epochs, share of fixed ones, gaps of the base, findings."""
        return _figures(self)

    def __repr__(self) -> str:
        """Say what `photocal ppk` prints."""
        return ppk_text(self.figures, catalogue("en"))

    def write(self, folder: str | Path) -> None:
        """Write `trajectory.csv`, `ppk.json` and `ppk.png` into a folder that is made.

        Parameters
        ----------
        folder
            Folder to write.
        """
        with output_folder(Path(folder)) as aside:
            write_ppk(aside, self)


@dataclass(frozen=True)
class BaseFigures:
    """Of the base: by how much its position lies above that of its own code solution, m."""

    up_off_code_solution_m: float | None = None


@dataclass(frozen=True)
class PpkFigures:
    """What later steps take from the figures of a PPK run.

    common: errors that all positions share; None of a rover that stood still.
    record: all figures, as in `ppk.json`.
    """

    fixed_percent: float
    base: BaseFigures = BaseFigures()
    common: CommonErrors | None = None
    record: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, record: dict[str, Any], where: object = FIGURES) -> "PpkFigures":
        """Take them from a record; InputMalformedError for one that lacks something."""
        return object_of(cls, {**record, "record": record}, where, _REMEDY)

    @classmethod
    def read(cls, path: Path) -> "PpkFigures":
        """Read `ppk.json`; errors as of `photocal.base.codec.parsed_json` and `of`."""
        return cls.of(object_of(dict[str, Any], parsed_json(path, _REMEDY), path, _REMEDY), path)


def write_ppk(folder: Path, made: Ppk) -> None:
    """Write the files of `Ppk.write` into a folder that is there."""
    write_trajectory(folder / "trajectory.csv", made.trajectory)
    write_json(folder / FIGURES, made.figures, 2)
    plot_ppk(made, folder / "ppk.png")


def _figures(result: Ppk) -> dict[str, Any]:
    """Return the figures of a run, ready for JSON."""
    rover, base = result.inputs.rover.time, result.inputs.base.time
    trajectory = result.trajectory
    first, last = max(rover.ns[0], base.ns[0]), min(rover.ns[-1], base.ns[-1])
    counts = {name: int((trajectory.status == name).sum()) for name in ("fixed", "float", "single")}
    say, options = catalogue("en"), result.options
    of_options = ("systems", "elevation_deg", "rover_antenna_m", "base_antenna_m")
    listed_gaps = 10
    figures: dict[str, Any] = {
        "schema": "photocal.ppk/1",
        "engine": ENGINE,
        "mode": result.mode,
        "options": {
            **picked(options, *of_options, least_ratio="ratio"),
            "frequencies": "L1+L2" if options.two_frequencies else "L1",
        },
        "rover": _span(result.inputs.rover),
        "base": {
            **_span(result.inputs.base),
            **_place(geodetic(result.inputs.base_m)),
            "position_from": result.inputs.base_source,
            **_frame(result.inputs.base_frame),
            "off_code_solution_m": np.linalg.norm(result.base_off_code_m),
            "up_off_code_solution_m": result.base_off_code_m[2],
            "gaps": len(result.base_gaps_s),
            "longest_gaps": [
                {"from_gps": t.iso()[0], "seconds": s} for t, s in result.base_gaps_s[:listed_gaps]
            ],
        },
        "overlap_s": float(last - first) / 1e9,
        "epochs": len(trajectory),
        **counts,
        "rover_epochs_without_position": len(rover) - len(trajectory) if result.mode != "static" else 0,
        "fixed_percent": 100.0 * counts["fixed"] / len(trajectory),
        "remarks": result.inputs.remarks,
        "findings": [finding_json(finding, say) for finding in _findings(result, counts, len(trajectory))],
    }
    if result.judgement is not None:
        figures["validation"] = _validation(result, result.judgement)
    if result.mode == "static":
        figures["position"] = _place(trajectory.place[0])
    else:
        figures["common"] = result.common.as_json()
    plain: dict[str, Any] = as_plain(figures)
    return plain


def _place(values: Iterable[Any]) -> dict[str, Any]:
    return dict(zip(("lat_deg", "lon_deg", "height_m"), values, strict=True))


def _frame(known: BaseFrame | None) -> dict[str, Any]:
    moved = None if known is None else known.moved
    return {} if moved is None else {"moved": moved.as_json()}


def _findings(result: Ppk, counts: dict[str, int], epochs: int) -> Iterator[Finding]:
    """Find what should not pass silently into results."""
    # Corrections that are this old still serve; longer gaps are reported.
    long_gap_s = 30.0
    fixed = 100.0 * counts["fixed"] / epochs
    good_share = 95.0
    if fixed < good_share:
        figures = {"percent": fixed, "n_float": float(counts["float"]), "n_single": float(counts["single"])}
        yield Finding("ppk-not-fixed", "doubtful", figures=figures)
    off = float(np.linalg.norm(result.base_off_code_m))
    # Code positions of single frequency receivers are good to two or three metres.
    suspect_base_m = 5.0
    if off > suspect_base_m:
        yield Finding("base-position", "grave", figures={"off_m": off}, clauses=("off-code",))
    if result.inputs.base_frame is not None:
        yield from result.inputs.base_frame.findings()
    lost = [(t, s) for t, s in result.base_gaps_s if s > long_gap_s]
    if lost:
        longest: dict[str, Any] = {"n": float(len(lost)), "limit_s": long_gap_s}
        longest |= {"longest_s": float(lost[0][1]), "from_gps": lost[0][0].iso()[0]}
        yield Finding("base-gaps", "doubtful", figures=longest)


def _span(file: Any) -> dict[str, Any]:
    return {
        "epochs": len(file.time),
        "from_gps": file.time[[0]].iso()[0],
        "to_gps": file.time[[-1]].iso()[0],
        "interval_s": file.interval_s,
    }


def _validation(result: Ppk, judgement: ValidatedFixes) -> dict[str, Any]:
    fixed = judgement.solution.quality == 1
    apart = judgement.separation_m
    known = np.isfinite(apart).all(axis=1)
    return {
        "fixed_by_the_engine": (result.combined.quality == 1).sum(),
        "demoted": {reason: rows.sum() for reason, rows in judgement.demoted.items()},
        "median_ratio_of_fixes": np.median(result.combined.ratio[fixed]) if fixed.any() else None,
        "float_sigma_factor_enu": judgement.float_factor,
        "combinations_replaced": result.replaced,
        "directions_apart": _directions_apart(judgement),
        "doppler_velocity_sigma_m_s": judgement.velocity_sigma_m_s,
        "forward_minus_backward_rms_enu_m": {
            "fixed": _rms(apart[known & fixed & (np.abs(apart) < 0.2).all(axis=1)]),
            "others": _rms(apart[known & ~fixed]),
        },
    }


def _directions_apart(judgement: ValidatedFixes) -> list[dict[str, Any]]:
    """List where a position counts as fixed though the directions are apart, and which was taken."""
    # The engine takes the direction with the better status; where both are fixed and differ, neither counts.
    apart = np.linalg.norm(judgement.separation_m, axis=1)
    # Directions this far apart where one is taken as fixed are reported: two fixes agree better.
    apart_m = 0.10
    rows = np.flatnonzero((judgement.solution.quality == FIXED) & (apart > apart_m))
    places = []
    for place in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else ():
        fixed = (judgement.directions[place] == FIXED).all(axis=0)
        time = judgement.solution.time
        places.append(
            {
                "from_gps": time[place[:1]].iso()[0],
                "to_gps": time[place[-1:]].iso()[0],
                "epochs": len(place),
                "largest_m": apart[place].max(),
                "taken": "forward" if fixed[0] else "backward" if fixed[1] else "by turns",
            }
        )
    return places


def _rms(values: Floats) -> Floats | None:
    return np.sqrt(np.mean(values**2, axis=0)) if len(values) else None


def ppk_text(figures: dict[str, Any], say: Catalogue) -> str:
    """Return the summary in words."""
    base, options = figures["base"], figures["options"]
    method = {key: options[key] for key in ("systems", "frequencies")}
    method |= {"mode": figures["mode"], "engine": figures["engine"]}
    counts = {key: figures[key] for key in ("epochs", "fixed", "float", "single")}
    lines = [say("trajectory.solution", elevation=say.as_given(options["elevation_deg"]), **method)]
    for role in ("rover", "base"):
        one = figures[role]
        ends = {"begins": one["from_gps"], "ends": one["to_gps"], "epochs": one["epochs"]}
        lines.append(say(f"trajectory.{role}", **ends))
    lines += [
        say("trajectory.overlap", seconds=say.fixed(figures["overlap_s"], 0), gaps=base["gaps"]),
        say("trajectory.base_position", source=base["position_from"], **_printed(base)),
        say("trajectory.off_code", metres=say.fixed(base["off_code_solution_m"], 1)),
        say("trajectory.epochs", percent=say.fixed(figures["fixed_percent"], 1), **counts),
        say("trajectory.missing", n=figures["rover_epochs_without_position"]),
    ]
    lines += [
        say("trajectory.gap", seconds=say.fixed(gap["seconds"], 0), begins=gap["from_gps"])
        for gap in base["longest_gaps"][:3]
    ]
    if "validation" in figures:
        lines += _validation_text(figures["validation"], say)
    if "common" in figures:
        lines += common_text(figures["common"], say)
    if "position" in figures:
        lines.append(say("trajectory.position", **_printed(figures["position"])))
    warnings = [
        say("trajectory.warning", text=finding_text(one, say, plain))
        for one in findings_of(figures["findings"], "ppk")
    ]
    return "\n".join([*lines, *figures["remarks"], *warnings])


def _printed(position: dict[str, Any]) -> dict[str, str]:
    """Give a position as programs read it, with decimal points in every language."""
    lat, lon, height = (position[key] for key in ("lat_deg", "lon_deg", "height_m"))
    return {"lat": f"{lat:.9f}", "lon": f"{lon:.9f}", "height": f"{height:.4f}"}


def _validation_text(validation: dict[str, Any], say: Catalogue) -> list[str]:
    # As many as a screen shows beside the summary.
    listed_places = 10
    demoted = {reason: count for reason, count in validation["demoted"].items() if count}
    lines = [say("trajectory.fixed_by_engine", n=validation["fixed_by_the_engine"])]
    reasons = [f"  {count} {say(f'trajectory.demoted.{reason}')}" for reason, count in demoted.items()]
    lines += reasons or [say("trajectory.demoted_none")]
    if validation["combinations_replaced"]:
        lines.append(say("trajectory.replaced", n=validation["combinations_replaced"]))
    if validation["median_ratio_of_fixes"] is not None:
        lines.append(say("trajectory.ratio", ratio=say.fixed(validation["median_ratio_of_fixes"], 1)))
    for kind, rms in validation["forward_minus_backward_rms_enu_m"].items():
        if rms is not None:
            spread = " ".join(say.fixed(v, 3) for v in rms)
            lines.append(say("trajectory.directions", kind=kind, spread=spread))
    places = validation["directions_apart"]
    for place in places[:listed_places]:
        taken = say(f"trajectory.{place['taken'].replace(' ', '_')}")
        told = {"begins": place["from_gps"], "epochs": place["epochs"], "taken": taken}
        lines.append(say("trajectory.apart", metres=say.fixed(place["largest_m"], 2), **told))
    if len(places) > listed_places:
        lines.append(say("trajectory.more_places", n=len(places) - listed_places))
    factors = ", ".join(say.fixed(v, 0) for v in validation["float_sigma_factor_enu"])
    lines.append(say("trajectory.float_factors", factors=factors))
    return lines


def plot_ppk(result: Ppk, path: Path) -> None:
    """Draw track, height, separation of the directions and ratio."""
    t = result.trajectory
    east, north, _ = t.offsets(np.median(t.place, axis=0)).T
    minutes = (t.time.ns - t.time.ns[0]) / 60e9
    with output_picture(path, (11, 8), 10.0, 120) as figure:
        track, height, apart, ratio = figure.subplots(2, 2).ravel()
        for name, colour in (("single", "tab:red"), ("float", "tab:orange"), ("fixed", "tab:green")):
            rows = t.status == name
            track.plot(east[rows], north[rows], ".", ms=3, color=colour, label=f"{name} {int(rows.sum())}")
            height.plot(minutes[rows], t.height_m[rows], ".", ms=3, color=colour)
        track.set(
            xlabel="east / m",
            ylabel="north / m",
            title="Track\n(fixed: centimetres; float: decimetres; single: metres)",
            aspect="equal",
        )
        track.legend()
        height.set(
            xlabel="time / min", ylabel="ellipsoidal height / m", title="Height\n(colours as in the track)"
        )
        if result.judgement is not None:
            for column, letter in enumerate("ENU"):
                distance = np.abs(result.judgement.separation_m[:, column])
                apart.semilogy(minutes, np.maximum(distance, 1e-4), ".", ms=2, label=letter)
            apart.legend()
        apart.set(
            xlabel="time / min",
            ylabel="|forward - backward| / m",
            title="Separation of the directions\n(millimetres where both are fixed; more where one is float)",
        )
        ratio.semilogy(minutes, np.maximum(result.combined.ratio, 1.0), ".", ms=2)
        ratio.axhline(
            result.options.ratio, color="k", lw=0.8, label=f"least for a fix: {result.options.ratio:g}"
        )
        ratio.legend()
        ratio.set(
            xlabel="time / min",
            ylabel="ratio",
            title="Ratio test of the ambiguities\n(second best to best; fixes lie above the line)",
        )
