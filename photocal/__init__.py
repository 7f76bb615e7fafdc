"""The processing side: from flight log, images and control to a calibrated camera and its certificate.

`import photocal` is quick: what it offers (`dir(photocal)`, docs/api.md) is loaded when it is used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from photocal.api import *  # noqa: F403


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from photocal.base.version import __version__

        return __version__
    if not name.startswith("_"):
        api = import_module("photocal.api")
        if name in api.__all__:
            return getattr(api, name)
    raise AttributeError(f"module 'photocal' has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(import_module("photocal.api").__all__)
