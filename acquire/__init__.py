"""The field side: record, import, replay and inspect flights; owner of the flight log."""

__version__ = "0.1.0"
