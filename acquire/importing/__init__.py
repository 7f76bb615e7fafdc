"""Recordings of other programs brought into the flight log."""
