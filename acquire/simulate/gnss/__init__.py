"""Satellites and receivers that never were: what a pair of GNSS receivers would have put on the wire."""
