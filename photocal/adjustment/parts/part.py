"""One part of a block: its points, all their rays, and the images that these come from."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from photocal.adjustment.network import Network
from photocal.adjustment.parts.dissection import Dissection
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import ConfigurationError
from photocal.geometry.camera import OWN, PARAMETERS

# Numbers that an image has for its unknowns, and a camera.
OF_IMAGE, OF_CAMERA = 6 + len(OWN), len(PARAMETERS)


@dataclass(frozen=True)
class SubNetwork:
    """A network of its own that adds to the whole what no other part does.

    network: with the cameras and the mounting of the whole.
    images, points, rays (n,): which ones of the whole these are.
    inside (images,): whether no other part has the image.
    home (images,): whether what else is observed at the image counts here.
    first: whether what is observed of the cameras and of the mounting counts here.
    count: images of the whole.
    """

    network: Network
    images: Integers
    points: Integers
    rays: Integers
    inside: Flags
    home: Flags
    first: bool
    count: int


def require_divisible(network: Network) -> None:
    """Refuse what no part could hold alone.

    raises ConfigurationError: for observations between points, laser distances and rigs.
    """
    if len(network.relations.kind) or len(network.lasers.image) or len(network.rig.first):
        raise ConfigurationError(
            "observations between points, laser distances and rigs cannot be adjusted in parts",
            "adjust the block whole, or leave them out",
        )


def images_together(image: Integers, point: Integers, count: int) -> csr_array:
    """Pairs of images that share a point, (images, images), from rays that are sorted by point."""
    _, point = np.unique(point, return_inverse=True)
    seen = csr_array(
        (np.ones(len(image), dtype=np.int32), (point, image)), shape=(point.max(initial=-1) + 1, count)
    )
    return csr_array(seen.T @ seen)


def part_of_points(
    dissection: Dissection, centre: Floats, ray_image: Integers, ray_point: Integers, count: int
) -> Integers:
    """Part of each point: that of its images, or the nearest one below its separator.

    ray_image, ray_point (rays,): sorted by point, each of which has a ray.
    returns (points,): places in `Dissection.parts`.
    """
    # All images of a point are in sets one above the other: the lowest has the least number.
    lowest = np.full(count, len(dissection.parent))
    np.minimum.at(lowest, ray_point, dissection.node[ray_image])
    part, last = dissection.first_part[lowest], dissection.last_part[lowest]
    among = np.flatnonzero(last > part + 1)
    if not len(among):
        return np.asarray(part)
    seen = np.maximum(np.bincount(ray_point, minlength=count), 1)
    place = np.column_stack([np.bincount(ray_point, centre[ray_image, a], count) / seen for a in range(3)])
    inside = np.isin(dissection.node, dissection.parts)
    for node in np.unique(lowest[among]):
        points = among[lowest[among] == node]
        own = dissection.first_part[dissection.node]
        images = np.flatnonzero(
            inside & (own >= dissection.first_part[node]) & (own < dissection.last_part[node])
        )
        part[points] = own[images[cKDTree(centre[images]).query(place[points])[1]]]
    return np.asarray(part)


@dataclass(frozen=True)
class Shares:
    """Which part has what of a block.

    home (images,): place of the part at which what else is observed of an image counts.
    first: the part at which what is observed of cameras and mounting counts.
    """

    dissection: Dissection
    home: Integers
    first: int


def homes_among(dissection: Dissection, part: Integers, ray_image: Integers, ray_point: Integers) -> Integers:
    """First part that has each image by some rays, (images,); the number of parts where none has it."""
    home = np.full(len(dissection.node), len(dissection.parts))
    np.minimum.at(home, ray_image, part[ray_point])
    return home


def shares(dissection: Dissection, home: Integers, network: Network) -> Shares:
    """Share images among parts; `home`: the first part that has each, over all rays."""
    own = dissection.first_part[dissection.node]
    # An inner image that no ray shows is of its part all the same.
    inner = np.isin(dissection.node, dissection.parts)
    home = np.where(inner | (home == len(dissection.parts)), own, home)
    mounted = np.concatenate([home[network.positions.image], home[network.attitudes.image]])
    return Shares(dissection, home, int(mounted[0]) if len(mounted) else 0)


def divided(network: Network, dissection: Dissection) -> Iterator[SubNetwork]:
    """Divide a network into parts, in their order.

    raises ConfigurationError: for what cannot be divided.
    """
    require_divisible(network)
    rays, centre = network.rays, np.nan_to_num(network.exposures.started[:, 3:])
    part = part_of_points(dissection, centre, rays.image, rays.point, len(network.points.values))
    shared = shares(dissection, homes_among(dissection, part, rays.image, rays.point), network)
    of_ray = part[rays.point]
    for number in range(len(dissection.parts)):
        points, of_part = np.flatnonzero(part == number), np.flatnonzero(of_ray == number)
        place = np.full(len(part), -1)
        place[points] = np.arange(len(points))
        chosen = rays.rows(of_part)
        datum = network.datum_points
        if datum is not None and len(datum):
            datum = place[datum]
            datum = datum[datum >= 0]
        elif datum is not None:
            datum = np.arange(len(points))
        own = replace(
            network,
            points=network.points.rows(points),
            rays=replace(chosen, point=place[chosen.point]),
            point_names=tuple(network.point_names[j] for j in points),
            datum_points=datum,
        )
        yield part_of(own, points, of_part, shared, number)


def part_of(network: Network, points: Integers, rays: Integers, shared: Shares, number: int) -> SubNetwork:
    """Make a part of a network that has all images, but only its points and rays.

    points, rays: which ones of the whole these are.
    """
    at_home = shared.home == number
    here = at_home.copy()
    here[network.rays.image] = True
    images, place = np.flatnonzero(here), np.cumsum(here) - 1
    observed = {}
    for name in ("positions", "attitudes"):
        given = getattr(network, name)
        kept = at_home[given.image]
        observed[name] = replace(given.rows(kept), image=place[given.image[kept]])
    smaller = replace(
        network,
        exposures=network.exposures.rows(images),
        rays=replace(network.rays, image=place[network.rays.image]),
        image_names=tuple(network.image_names[i] for i in images),
        **observed,
    )
    inside = shared.dissection.node[images] == shared.dissection.parts[number]
    return SubNetwork(
        smaller,
        images,
        points,
        rays,
        inside,
        at_home[images],
        number == shared.first,
        len(network.image_names),
    )
