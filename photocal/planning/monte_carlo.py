"""Whether flights show the precision that a plan promises: simulated ones with random errors."""

from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError
from photocal.planning.plan import Plan
from photocal.planning.simulated_adjustment import PlannedSurvey, planned_network


@dataclass(frozen=True)
class FlightErrors:
    """Promised and found precision of the check points of a planned flight.

    Attributes
    ----------
    promised_m
        Root mean square of the standard deviations of X, Y, Z, m, shape (3,).
    errors_m
        Adjusted less true coordinates, m, shape (flights, points, 3).
    """

    promised_m: Floats
    errors_m: Floats

    @property
    def found_m(self) -> Floats:
        """Root mean square errors of X, Y, Z, m, shape (3,)."""
        return np.asarray(np.sqrt(np.mean(np.square(self.errors_m), axis=(0, 1))))


def simulate_flights(plan: Plan, flights: int = 20, *, seed: int = 0) -> FlightErrors:
    """Fly a plan several times with random errors of images and control, and adjust each flight.

    Parameters
    ----------
    plan
        A planned flight; the sigmas of its observations are those of its precision options.
    flights
        Number of simulated flights.
    seed
        Of the random errors: the same seed gives the same flights.

    Returns
    -------
    FlightErrors
        What the covariance promises, and what the flights show.

    Raises
    ------
    IllPosedError
        When two photos see no check point, or the flight does not determine its points.

    Examples
    --------
    >>> import photocal
    >>> corners = [(-51.41, -22.12), (-51.4085, -22.12), (-51.4085, -22.1212), (-51.41, -22.1212)]
    >>> camera = photocal.FlightOptions(focal_mm=8.8, pixel_um=2.41, image_px="5472x3648", height=100.0)
    >>> plan = photocal.plan(photocal.area_from_corners(corners, "field"), camera.request())
    >>> errors = photocal.simulate_flights(plan, 5)
    >>> bool((abs(errors.found_m / errors.promised_m - 1.0) < 0.5).all())
    True
    """
    network, check = planned_network(plan.flight, plan.layout, plan.survey or PlannedSurvey())
    if not len(check):
        raise IllPosedError("no check point is seen by two photos", "plan more overlap or more check points")
    variance = np.diagonal(adjust(network).point_covariance[check], axis1=1, axis2=2)
    rng, errors = np.random.default_rng(seed), []
    points, rays = network.points, network.rays
    weight = points.weight[:, range(3), range(3)]
    sigma = np.where(weight > 0, 1 / np.sqrt(np.maximum(weight, 1e-12)), 0.0)
    for _ in range(flights):
        surveyed = points.values + rng.normal(0, 1, sigma.shape) * sigma
        measured = rays.plane + rng.normal(0, 1, rays.plane.shape) * rays.sigma
        flown = replace(network, points=replace(points, values=surveyed), rays=replace(rays, plane=measured))
        errors.append(adjust(flown).points[check] - points.values[check])
    return FlightErrors(np.sqrt(variance.mean(axis=0)), np.array(errors))
