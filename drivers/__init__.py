"""Bytes to messages and back: one module per device or file family, no files, no clock, no maths."""
