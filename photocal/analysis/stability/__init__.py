"""Whether two calibrations are the same camera: misclosure, zero rotation, rotation, resection."""
