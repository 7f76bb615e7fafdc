"""Blocks adjusted in parts: each eliminated exactly, then joined along separators (Helmert 1880)."""
