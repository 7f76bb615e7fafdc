"""The world of a simulated flight: ground, targets, plan, vehicle, camera, telemetry, pictures, truth."""
