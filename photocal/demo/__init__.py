"""Demonstrations: a simulated flight from the wires to the certificate, a published calibration."""
