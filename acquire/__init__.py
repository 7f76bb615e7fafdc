"""The field side: record, import, replay and inspect flights; owner of the flight log."""

from typing import Any


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from photocal.base.version import __version__

        return __version__
    raise AttributeError(f"module 'acquire' has no attribute {name!r}")
