"""The version of the program, as the installed package states it: for logs, records and certificates."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("photocal")
except PackageNotFoundError:
    # Sources that nobody has installed.
    __version__ = "unknown"
