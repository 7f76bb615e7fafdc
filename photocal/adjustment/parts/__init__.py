"""Blocks that are adjusted in parts: exact elimination of each part, joined along separators (Helmert 1880)."""
