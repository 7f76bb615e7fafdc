"""Pieces of work on several processes or machines."""
