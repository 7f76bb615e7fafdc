"""Whether the precision that a plan promises is what flights of it would show: twenty simulated ones."""

from dataclasses import replace

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.planning.area import area_from_corners
from photocal.planning.flight import FlightRequest, plan_flight, suggest_layout
from photocal.planning.frame import Frame
from photocal.planning.simulated_adjustment import Survey, planned_network

corners = [(-22.1200, -51.4100), (-22.1200, -51.4085), (-22.1212, -51.4085), (-22.1212, -51.4100)]
flight = plan_flight(
    area_from_corners(corners, "field"), FlightRequest(Frame(8.8e-3, 2.41e-6, 5472, 3648), 100.0, 0.7, 0.6)
)
layout = suggest_layout(flight.corners_m, control=5, check=8, margin_m=10.0)
network, check = planned_network(flight, layout, Survey(image_px=0.5, control_m=(0.02, 0.03)))

promised = np.sqrt(np.diagonal(adjust(network).point_covariance[check], axis1=1, axis2=2))
rng, errors = np.random.default_rng(5), []
points, rays = network.points, network.rays
weight = points.weight[:, range(3), range(3)]
sigma = np.where(weight > 0, 1 / np.sqrt(np.maximum(weight, 1e-12)), 0.0)
for _ in range(20):
    surveyed = points.values + rng.normal(0, 1, sigma.shape) * sigma
    measured = rays.plane + rng.normal(0, 1, rays.plane.shape) * rays.sigma
    flown = replace(network, points=replace(points, values=surveyed), rays=replace(rays, plane=measured))
    errors.append(adjust(flown).points[check] - points.values[check])
found = np.sqrt(np.mean(np.square(errors), axis=(0, 1)))
print("promised, X Y Z, mm:", np.round(1e3 * np.sqrt((promised**2).mean(axis=0)), 1))
print("found in twenty flights:", np.round(1e3 * found, 1))
