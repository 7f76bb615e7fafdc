"""Plausibility of a calibration report: figures that contradict each other or the camera."""
