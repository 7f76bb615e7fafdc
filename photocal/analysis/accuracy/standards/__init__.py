"""Accuracy standards as data: one TOML file each, every figure with its source."""
