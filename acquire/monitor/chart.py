"""What is drawn on the map: lines and points by name, as they are now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquire.monitor.state import State
from drivers.arrays import Floats


@dataclass(frozen=True)
class Layer:
    """A line or points of one name.

    kind: ``track``, ``picture``, ``missed`` or ``station``.
    name: whose.
    points (n, 2): latitude and longitude, degrees.
    edition: as long as it stays, points were only added.
    labels: what stands beside the points; empty for nothing.
    """

    kind: str
    name: str
    points: Floats
    edition: str
    labels: tuple[str, ...] = ()


def layers(state: State) -> list[Layer]:
    """Return what is drawn of a state: one track for each vehicle and receiver, each picture once."""
    drawn = [
        Layer("track", name, track.points, f"{state.flight} {key} {track.thinned}")
        for name, key in _shown_tracks(state).items()
        for track in [state.tracks[key]]
    ]
    # Both the vehicle and the receiver tell of the same picture: what the camera reported counts.
    kinds = {kind for _, kind in state.pictures}
    kind = "feedback" if "feedback" in kinds else "rising"
    drawn += [
        Layer("picture", name, track.points, f"{state.flight} {told}")
        for (name, told), track in sorted(state.pictures.items())
        if told == kind
    ]
    for name, counted in (*sorted(state.exposures.items()), *sorted(state.marks.items())):
        missed = [(str(t.number), t.place) for t in counted.unreported if t.place is not None]
        if missed:
            points = np.array([place for _, place in missed])
            labels = tuple(label for label, _ in missed)
            drawn.append(Layer("missed", name, points, f"{state.flight} {labels}", labels))
    drawn += [
        Layer("station", name, np.array([place]), f"{state.flight} {place}")
        for name, place in sorted(state.stations.items())
    ]
    return drawn


def _shown_tracks(state: State) -> dict[str, str]:
    """Return the topic of the track by its name: the filter of a vehicle rather than its receivers."""
    shown: dict[str, str] = {}
    for key in sorted(state.tracks):
        parts = key.split("/")
        name = parts[1] if parts[0] == "gnss" else key.removesuffix("/position")
        if parts[0] != "gnss" or name not in shown:
            shown[name] = key
    # A vehicle's second receiver lies under the track of its filter.
    filters = {key.split("/")[0] for key in state.tracks if key.endswith("/position")}
    return {
        name: key
        for name, key in shown.items()
        if not (key.startswith("gnss/") and name.removesuffix("-2") in filters)
    }
