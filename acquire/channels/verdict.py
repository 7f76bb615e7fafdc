"""What the figures of a flight log mean before packing up: whether it is complete and can be processed."""

from dataclasses import dataclass
from typing import Any

# Raw observations, and the orbits that a trajectory needs as well, by protocol.
# RTCM: 1004, 1012, and MSM 4 to 7 of GPS, GLONASS, Galileo, QZSS and BeiDou.
_MSM = tuple(str(system + kind) for system in (1070, 1080, 1090, 1110, 1120) for kind in (4, 5, 6, 7))
_OBSERVATIONS = frozenset(("RXM-RAWX", "1004", "1012", *_MSM))
_ORBITS = ("RXM-SFRBX", "1019", "1020", "1042", "1045", "1046")
# How an exposure is seen, in the order in which a person thinks of it.
_SEEN = {"trigger": "triggered", "feedback": "reported by the autopilot", "mark": "time marks"}
_LACKS = {
    "trigger": "were triggered",
    "feedback": "were reported by the autopilot",
    "mark": "have a time mark",
}
# A pause of a link counts as a gap from here on.
GAP_S = 2.0


@dataclass(frozen=True)
class LogVerdict:
    """Sentences about a log, and what stands in the way of processing it.

    exposures: how many pictures were triggered, reported and marked.
    ppk, exposures_possible: what lacks for a trajectory, and for exposures; empty where nothing does.
    """

    complete: bool
    exposures: dict[str, int]
    ppk: tuple[str, ...]
    exposures_possible: tuple[str, ...]
    remarks: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return it for programs."""
        return {
            "complete": self.complete,
            "exposures": self.exposures,
            "ppk": {"possible": not self.ppk, "missing": list(self.ppk)},
            "exposures_possible": {
                "possible": not self.exposures_possible,
                "missing": list(self.exposures_possible),
            },
            "remarks": list(self.remarks),
        }

    def lines(self) -> list[str]:
        """Return the paragraph that comes first."""
        counts = ", ".join(
            f"{self.exposures[key]} {word}" for key, word in _SEEN.items() if key in self.exposures
        )
        head = f"pictures: {counts or 'none triggered, reported or marked'}"
        yes = "complete" if self.complete else "CHECK"
        processed = f"can be processed: PPK {_answer(self.ppk)}; exposures {_answer(self.exposures_possible)}"
        return [f"verdict: {yes}", f"  {head}", *(f"  {remark}" for remark in self.remarks), f"  {processed}"]


def _answer(lacks: tuple[str, ...]) -> str:
    return "yes" if not lacks else f"no ({', '.join(lacks)})"


def verdict_on(figures: dict[str, Any], exposures: dict[str, int]) -> LogVerdict:
    """Judge the figures of `LogSummary`.

    exposures: edges by kind: trigger, feedback, rising, falling.
    """
    seen = {key: exposures[key] for key in ("trigger", "feedback") if exposures.get(key)}
    # A pulse has two edges; which of them is the exposure is a matter of the camera.
    if marks := max((count for edge, count in exposures.items() if edge not in seen), default=0):
        seen["mark"] = marks
    links = {link["link"]: link for link in figures["links"]}
    raw = {name: _raw(link) for name, link in links.items()}
    receivers = [name for name, kind in raw.items() if kind]
    remarks = [*_of_exposures(seen), *(text for name in receivers for text in _of_receiver(name, raw[name]))]
    remarks += _of_damage(links.values())
    faultless = not remarks and figures["complete"]
    if not figures["complete"]:
        remarks.append("the log ends early: acquire recover saves its intact part")
    orbits = any(kind["type"] in _ORBITS for link in links.values() for kind in link["types"])
    return LogVerdict(
        faultless and bool(seen),
        seen,
        _lacks_for_ppk(receivers, orbits=orbits),
        () if seen.get("mark") or seen.get("feedback") else ("no time mark and no camera feedback",),
        tuple(remarks),
    )


def _raw(link: dict[str, Any]) -> list[dict[str, Any]]:
    return [kind for kind in link["types"] if kind["type"] in _OBSERVATIONS]


def _of_exposures(seen: dict[str, int]) -> list[str]:
    most = max(seen.values(), default=0)
    return [f"only {count} of {most} pictures {_LACKS[key]}" for key, count in seen.items() if count < most]


def _of_receiver(name: str, kinds: list[dict[str, Any]]) -> list[str]:
    # Of RTCM one system may be out of view: the steadiest of its messages tells.
    longest = min(kind["longest_gap_s"] or 0.0 for kind in kinds)
    return [f"{name}: raw observations with gaps, the longest {longest:.1f} s"] if longest > GAP_S else []


def _of_damage(links: Any) -> list[str]:
    return [
        f"{link['link']}: {link['damage_bytes']} bytes belong to no valid frame"
        for link in links
        if link["damage_bytes"] > 0.01 * max(link["frame_bytes"], 1)
    ]


def _lacks_for_ppk(receivers: list[str], *, orbits: bool) -> tuple[str, ...]:
    if not receivers:
        return ("no raw observations",)
    lacks = (
        []
        if len(receivers) > 1
        else [f"raw observations of {receivers[0]} only: give the base as a file of its own"]
    )
    return (*lacks, *(() if orbits else ("no satellite orbits: give a navigation file",)))
