"""Options of a step, defined once: for the command line, a project file and Python."""

from dataclasses import dataclass
from typing import Any, ClassVar


@dataclass(frozen=True)
class Option:
    """What a person reads of an option; stands in the `Annotated` of its field.

    Parameters
    ----------
    text
        Help, with the unit where the name does not end with it.
    names
        As on the command line (`("-o", "--output")`), where not `--` and the name of the field.
    least, most
        Smallest and largest value; None where there is none.
    """

    text: str
    names: tuple[str, ...] = ()
    least: float | None = None
    most: float | None = None


class Options:
    """Base of the options of a step: frozen dataclasses whose fields carry an `Option`.

    A field has the name of the key and of the argument, and its default; lists are `tuple[X, ...]`.
    `photocal.base.console.spread` makes arguments of a command of them; a `Table` of a TOML file takes
    the class as the type of a key. What fits no other value is refused in `__post_init__`.
    Modules that define options import nothing heavy: `--help` reads them.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from typing import Annotated
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Thinning(Options):
    ...     cell_px: Annotated[float, Option("Side of a cell, px.")] = 50.0
    >>> Thinning(cell_px=20.0)
    Thinning(cell_px=20.0)
    """

    # As in every table of a file, an unknown key is an error.
    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}
