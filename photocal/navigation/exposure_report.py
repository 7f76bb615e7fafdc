"""What a person judges exposures by: figures and sentences."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, as_plain, picked
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_json
from photocal.navigation.common_errors import common_text
from photocal.navigation.device_clocks import ComparedClocks, clock_sentences
from photocal.navigation.events import Events
from photocal.navigation.exposures import CameraMatch, Exposures
from photocal.navigation.ppk_figures import PpkFigures
from photocal.navigation.trajectory import LARGEST_GAP_S

# What schema 1 calls the outcome of a check; all others failed.
_VERDICTS = {"passed": "passed", "note": "passed", "untested": "not possible"}


def exposure_figures(
    exposures: Exposures,
    events: Events,
    cameras: list[CameraMatch],
    clocks: list[ComparedClocks],
    checks: list[Finding],
    ppk: PpkFigures | None,
) -> dict[str, Any]:
    """Return the figures of a run, ready for JSON; `findings` are the warnings among them."""
    placed, say = exposures.placed, catalogue("en")
    status = placed.status[placed.placed]
    failed = [check for check in checks if not check.small]
    findings = (*failed, *_unmatched(cameras, events), *_missing(exposures))
    missing = np.flatnonzero(~placed.placed).tolist()
    figures: dict[str, Any] = as_plain(
        {
            "schema": "photocal.exposures/1",
            "events": len(events),
            "events_from": events.source,
            "remarks": [*events.remarks, *clock_sentences(clocks)],
            "placed": placed.placed.sum(),
            **{name: (status == name).sum() for name in ("fixed", "float", "single")},
            "not_placed": [
                {
                    "event": exposures.number[i],
                    "time_gps": exposures.time[[i]].iso()[0],
                    "reason": exposures.reason(i),
                }
                for i in missing
            ],
            "with_attitude": exposures.attitude.known.sum(),
            "height": exposures.height_kind,
            "heights": _heights(exposures),
            "sigma": _sigmas(exposures),
            "cameras": [_camera(camera, events) for camera in cameras],
            "clocks": [clock.figures() for clock in clocks],
            "checks": [
                finding_json(check, say) | {"verdict": _VERDICTS.get(check.severity, "failed")}
                for check in checks
            ],
            "findings": [finding_json(finding, say) for finding in findings],
            "common": None if ppk is None else ppk.record.get("common"),
            "ppk": None if ppk is None else ppk.record,
        }
    )
    return figures


def _heights(exposures: Exposures) -> dict[str, Any]:
    rows = exposures.placed.placed
    kinds = {exposures.height_kind: exposures.placed.height_m[rows]}
    if exposures.above_take_off_m is not None:
        kinds["above the take-off, as the images state it"] = exposures.above_take_off_m
    return {
        kind: {"lowest_m": np.min(v), "highest_m": np.max(v)}
        for kind, values in kinds.items()
        if len(v := values[np.isfinite(values)])
    }


def _sigmas(exposures: Exposures) -> dict[str, Any]:
    """Return medians of the standard deviations."""
    covariance = exposures.placed.covariance_m2[exposures.placed.placed]
    position = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    angles = np.degrees(exposures.angle_sigma[exposures.attitude.known])
    return {"position_enu_m": _medians(position), "roll_pitch_yaw_deg": _medians(angles)}


def _medians(values: Floats) -> Floats | None:
    known = values[np.isfinite(values).all(axis=1)]
    return np.median(known, axis=0) if len(known) else None


def _camera(camera: CameraMatch, events: Events) -> dict[str, Any]:
    m = camera.matching
    return {
        "camera": camera.camera,
        "matched": len(m.image),
        "unmatched_images": [camera.names[i] for i in m.unmatched_images.tolist()],
        "ambiguous_images": [camera.names[i] for i in m.ambiguous_images.tolist()],
        "unmatched_events": events.number[m.unmatched_events],
        **picked(m, clock_offset_s="offset_s", clock_offset_sigma_s="offset_sigma_s", residual_s="scatter_s"),
        "clock_drift_ppm": m.drift * 1e6,
        "clock_drift_sigma_ppm": m.drift_sigma * 1e6,
    }


def _unmatched(cameras: list[CameraMatch], events: Events) -> Iterator[Finding]:
    """Find images and events without a partner."""
    for camera in cameras:
        m = camera.matching
        images = {"images-without-event": m.unmatched_images, "images-ambiguous": m.ambiguous_images}
        for code, rows in images.items():
            names = tuple(camera.names[i] for i in rows.tolist())
            if names:
                yield Finding(code, "doubtful", camera.camera, {"n": float(len(names)), "images": names})
        numbers = tuple(str(events.number[i]) for i in m.unmatched_events.tolist())
        if numbers:
            figures = {"n": float(len(numbers)), "events": numbers}
            yield Finding("events-without-image", "doubtful", camera.camera, figures)


def _missing(exposures: Exposures) -> Iterator[Finding]:
    """Find what lacks a position or an attitude; without any attitude none was recorded."""
    there, turned = exposures.placed.placed, exposures.attitude.known
    gap = exposures.placed.gap_s
    without = {"outside-trajectory": ~there & ~np.isfinite(gap), "gap": ~there & np.isfinite(gap)}
    for cause, lost in without.items():
        if lost.any():
            figures: dict[str, Any] = {"events": tuple(str(n) for n in exposures.number[lost].tolist())}
            figures |= {"n": float(lost.sum()), "gap_s": float(np.max(gap[lost])), "limit_s": LARGEST_GAP_S}
            yield Finding("exposure-not-placed", "doubtful", figures=figures, cause=cause)
    count = float((there & ~turned).sum())
    if count and turned.any():
        yield Finding("telemetry-gap", "doubtful", figures={"n": count, "all": float(len(exposures))})


def exposures_text(figures: dict[str, Any]) -> str:
    """Return the summary in words."""
    # The table has all; a screen shows this many.
    listed = 12
    counts = ", ".join(f"{figures[name]} {name}" for name in ("fixed", "float", "single"))
    lines = [
        f"{figures['events']} events from {figures['events_from']}, {figures['placed']} placed: {counts}",
        f"{figures['with_attitude']} with attitude",
    ]
    for kind, span in figures["heights"].items():
        lines.append(f"height {kind}: {span['lowest_m']:.2f} to {span['highest_m']:.2f} m")
    sigma = figures["sigma"]
    if sigma["position_enu_m"]:
        lines.append("sigma (median) E N U " + " ".join(f"{v:.3f}" for v in sigma["position_enu_m"]) + " m")
    if sigma["roll_pitch_yaw_deg"]:
        angles = " ".join(f"{v:.2f}" for v in sigma["roll_pitch_yaw_deg"])
        lines.append(f"sigma (median) roll pitch yaw {angles} deg")
    if figures["common"] is not None:
        lines += common_text(figures["common"])
    lines += figures["remarks"]
    for camera in figures["cameras"]:
        rest = f"{len(camera['unmatched_images'])} images, {len(camera['unmatched_events'])} events"
        line = f"{camera['camera']}: {camera['matched']} matched, unmatched {rest}"
        if camera["matched"]:
            line += (
                f"; its clock is {camera['clock_offset_s']:+.3f} s (sigma "
                f"{camera['clock_offset_sigma_s']:.3f} s) off, drift {camera['clock_drift_ppm']:+.0f} ppm"
            )
        lines.append(line)
    missing = figures["not_placed"]
    lines += [f"event {x['event']} at {x['time_gps']}: {x['reason']}" for x in missing[:listed]]
    if len(missing) > listed:
        lines.append(f"... and {len(missing) - listed} more without a position: see exposures.csv")
    lines.append("checks:")
    words = {"passed": "ok    ", "failed": "FAILED", "not possible": "  -   "}
    lines += [f"  {words[c['verdict']]} {c['code']}: {c['text']}" for c in figures["checks"]]
    checked = {c["text"] for c in figures["checks"]}
    of_ppk = [] if figures["ppk"] is None else figures["ppk"].get("findings", [])
    lines += [f"WARNING {f['text']}" for f in (*of_ppk, *figures["findings"]) if f["text"] not in checked]
    return "\n".join(lines)
