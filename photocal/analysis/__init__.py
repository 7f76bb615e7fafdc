"""What a calibration is worth: significance, components, stability, hidden errors, method."""
