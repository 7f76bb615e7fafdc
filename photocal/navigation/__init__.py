"""Time, trajectory and exposures: the exterior orientation that the flight measured."""
