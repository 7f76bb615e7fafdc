"""The forms of an event and of an image observation that architecture.md lists: both ways are walked."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

import photocal
from acquire.channels.link import LinkLog
from acquire.channels.receiver import ReceiverDecoder
from acquire.log.reader import LogReader
from acquire.log.writer import LogWriter
from acquire.recording.reader import Inbox
from drivers.frames import GNSS, StreamFramer
from drivers.protocols import receiver_protocols
from photocal.adjustment.network import Network
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.measurement.features import FeatureSettings, detect
from photocal.measurement.pair_matching import match
from photocal.measurement.tie_block import with_ties
from photocal.measurement.tracks import join_tracks
from photocal.navigation.events import RISING, time_marks
from photocal.navigation.exposures import at_events
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.receiver_recording import read_receivers
from photocal.report.certificate_metadata import read_particulars
from photocal.report.issue import issue
from photocal.run.block import observed_positions
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly
from tests.photocal.navigation.test_marks_once import epoch, pulse
from tests.photocal.run.test_block import EAST_M, NORTH_M, exposures_of

PAGE = Path(__file__).parents[2] / "docs/architecture.md"


def listed(heading: str) -> list[str]:
    """Types of a table of the page."""
    table = PAGE.read_text(encoding="utf-8").split(f"| {heading} |")[1].split("\n\n")[0]
    return re.findall(r"^\| `([\w.]+)` \|", table, re.MULTILINE)


def names(forms: Iterator[object]) -> list[str]:
    return [f"{type(form).__module__}.{type(form).__qualname__}" for form in forms]


def ended(block: Block, folder: Path) -> Iterator[object]:
    """The adjusted block and its certificate."""
    block.write(folder / "block")
    result = photocal.adjust(photocal.read_block(folder / "block"))
    result.write(folder / "run")
    yield result
    given = read_particulars(None, dt.date(2026, 1, 2))
    yield issue(folder / "run", folder / "certificate", given, block=folder / "block")


def event_forms(folder: Path) -> Iterator[object]:
    flown = fly(folder / "flown", np.random.default_rng(1), Errors(), Plan(heights_m=(80.0, 110.0), tie=5))
    block = photocal.read_block(flown)
    count = len(block.images.names)
    inbox = Inbox("rover", lambda: 1_700_000_000 * 10**9)
    for k in range(count):
        inbox.put(epoch(100 + k) + pulse(k, 100.4 + k))
    arrivals = inbox.take(1 << 20)
    yield arrivals[0]
    batch = StreamFramer(GNSS).feed(b"".join(arrival.data for arrival in arrivals))
    yield batch
    (marks,) = (told["TIM-TM2"] for p in receiver_protocols() if "TIM-TM2" in (told := p.time_marks(batch)))
    yield marks
    with (folder / "flight.mcap").open("wb") as stream:
        writer = LogWriter(stream)
        log = LinkLog(writer.messages, "rover", [ReceiverDecoder("rover").feed])
        log.write(batch, np.full(len(batch), arrivals[0].time_ns))
        writer.close()
    chunks = LogReader(folder / "flight.mcap").chunks()
    yield next(part for chunk in chunks for part in chunk if part.channel.topic == "/camera/exposure")
    rover = read_receivers(FlightLog((folder / "flight.mcap",)))["rover"]
    events = time_marks(rover.marks(), RISING, "rover")
    assert len(events) == count
    yield events
    placed = exposures_of(flown)
    exposures = at_events(
        events, placed.placed, placed.attitude, events.accuracy_s, placed.images, placed.height_kind
    )
    yield exposures
    positions = observed_positions(exposures, block.images.names, "EPSG:32722", 0.0)
    yield positions
    local = replace(positions, values=positions.values - [EAST_M, NORTH_M, 0.0])
    yield from ended(replace(block, positions=local), folder)


def observation_forms(folder: Path) -> Iterator[object]:
    """Two images of one texture, the second shifted: what is found in both becomes tie points of a block."""
    texture = np.random.default_rng(2).integers(0, 255, (60, 80), dtype=np.uint8)
    grey = cv2.resize(texture, (640, 480), interpolation=cv2.INTER_CUBIC)
    settings = FeatureSettings(most=500)
    first, second = (detect(np.ascontiguousarray(image), settings) for image in (grey[:, 40:], grey[:, :-40]))
    yield first
    tracks = join_tracks([first, second], np.array([[0, 1]]), [match(first, second)])
    yield tracks
    block = photocal.read_block("photocal/demo/dcs460")
    nowhere = np.full((tracks.count, 3), np.nan)
    yield with_ties(block, tracks, nowhere, np.ones(len(tracks.track))).observations
    network: Network = assemble(block).network
    yield network.rays
    result, document = ended(block, folder)
    assert isinstance(result, photocal.Result)
    yield result.residuals
    yield document


def test_an_event_has_nine_forms_from_the_port_to_the_certificate(tmp_path: Path) -> None:
    assert names(event_forms(tmp_path)) == listed("event")
    assert len(listed("event")) <= 9


def test_an_image_observation_has_eight_forms_at_most(tmp_path: Path) -> None:
    assert names(observation_forms(tmp_path)) == listed("image observation")
    assert len(listed("image observation")) <= 8
