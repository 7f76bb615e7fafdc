"""Pictures as files: JPEG with what the camera writes into EXIF, and XMP of the gimbal where there is one."""

import datetime as dt
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from acquire.simulate.world.observations import kept_images
from acquire.simulate.world.render import make_scene, render
from acquire.simulate.world.telemetry import LABEL, make_filter
from acquire.simulate.world.world import World, picture_stamps
from photocal.base.arrays import Floats

MAKER = "simulated"
_EXIF, _GPS = 0x8769, 0x8825
_XMP = """<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"
 drone-dji:RelativeAltitude="{above:+.2f}"
 drone-dji:GimbalRollDegree="{roll:+.2f}"
 drone-dji:GimbalPitchDegree="{pitch:+.2f}"
 drone-dji:GimbalYawDegree="{yaw:+.2f}"/>
</rdf:RDF></x:xmpmeta>
<?xpacket end="w"?>"""


def write_pictures(world: World, folder: Path, advance: Callable[[float], None]) -> None:
    """Render and write all pictures that reach the office."""
    from PIL import Image

    given = world.configuration.pictures
    folder.mkdir(parents=True)
    scene = make_scene(world)
    # Made before the threads ask for it all at once.
    _ = scene.directions
    stamps, names = picture_stamps(world), world.exposures.names
    view = make_filter(world)
    places, _ = view.place(world.exposures.event_s)
    angles = np.degrees(view.angles(world.exposures.event_s))
    kept = np.flatnonzero(kept_images(world)).tolist()

    def make(number: int) -> None:
        """Render one picture and write it with its EXIF."""
        image = Image.fromarray(np.ascontiguousarray(render(scene, number)[..., ::-1]))
        exif = _exif(world, stamps[number], places[number], image.size)
        more: dict[str, Any] = {}
        if given.gimbal_xmp:
            above = float(places[number, 2]) - world.place.height_m - world.motion.ground_m
            roll, pitch, yaw = angles[number].tolist()
            # A camera that is fixed to the body looks down where the gimbal's pitch is -90.
            text = _XMP.format(above=above, roll=roll, pitch=pitch - 90, yaw=(yaw + 180) % 360 - 180)
            more["xmp"] = text.encode()
        path = folder / names[number]
        image.save(path, "JPEG", quality=given.quality, subsampling=0, exif=exif, **more)

    # Most of the time is spent outside the interpreter: threads share the painted ground.
    workers = 2
    with ThreadPoolExecutor(workers) as pool:
        for _ in pool.map(make, kept):
            advance(1 / len(kept))


def _exif(world: World, stamp: dt.datetime, place: Floats, size: tuple[int, int]) -> Any:
    from PIL import Image
    from PIL.TiffImagePlugin import IFDRational

    camera = world.configuration.camera
    taken = stamp.strftime("%Y:%m:%d %H:%M:%S")
    exif = Image.Exif()
    exif[0x010E] = LABEL
    exif[0x010F], exif[0x0110], exif[0x0132], exif[0x0112] = MAKER, camera.id, taken, 1
    photo = exif.get_ifd(_EXIF)
    photo[0x9003] = photo[0x9004] = taken
    if world.configuration.pictures.subseconds:
        photo[0x9291] = photo[0x9292] = f"{stamp.microsecond // 1000:03d}"
    photo[0x829A] = IFDRational(round(camera.exposure_s * 1e6), 1_000_000)
    photo[0x829D], photo[0x8827] = IFDRational(28, 10), 100
    photo[0x920A] = IFDRational(round(camera.nominal_mm * 1000), 1000)
    wide = camera.size_px[0] * camera.pitch_mm
    photo[0xA405] = round(camera.nominal_mm * 36 / wide)
    photo[0xA002], photo[0xA003] = size
    photo[0xA431] = f"{world.configuration.seed:04d}"
    gps = exif.get_ifd(_GPS)
    latitude, longitude = np.degrees(place[:2]).tolist()
    gps[1], gps[2] = "S" if latitude < 0 else "N", _sexagesimal(abs(latitude))
    gps[3], gps[4] = "W" if longitude < 0 else "E", _sexagesimal(abs(longitude))
    above_sea = float(place[2]) - world.configuration.place.geoid_m
    gps[5], gps[6] = b"\x01" if above_sea < 0 else b"\x00", IFDRational(round(abs(above_sea) * 1000), 1000)
    return exif


def _sexagesimal(degrees: float) -> tuple[Any, Any, Any]:
    from PIL.TiffImagePlugin import IFDRational

    whole, rest = divmod(round(degrees * 3600 * 100_000), 3600 * 100_000)
    minutes, seconds = divmod(rest, 60 * 100_000)
    return IFDRational(whole, 1), IFDRational(minutes, 1), IFDRational(seconds, 100_000)
