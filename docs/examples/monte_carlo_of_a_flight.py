"""Compare the predicted precision of a planned flight with the errors of twenty simulated ones."""

import numpy as np

import photocal

# Longitude and latitude, degrees.
corners = [(-51.4100, -22.1200), (-51.4085, -22.1200), (-51.4085, -22.1212), (-51.4100, -22.1212)]
flight = photocal.FlightOptions(
    focal_mm=8.8, pixel_um=2.41, image_px="5472x3648", height=100.0, forward=0.7, side=0.6
)
plan = photocal.plan(
    photocal.area_from_corners(corners, "field"),
    flight.request(),
    precision=photocal.PrecisionOptions(control=5, check=8),
)

errors = photocal.simulate_flights(plan, 20, seed=5)
print("predicted, X Y Z, mm:", np.round(1e3 * errors.promised_m, 1))
print("found in twenty flights:", np.round(1e3 * errors.found_m, 1))
