"""The source of a configured link."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Protocol

from acquire.transports.ntrip import NtripSource, ntrip_address
from acquire.transports.sources import Source, source_of
from drivers.errors import ConfigurationError


class Addressed(Protocol):
    """What a link says about its port."""

    @property
    def url(self) -> str:
        """The address."""
        ...

    @property
    def baud(self) -> int:
        """Speed of a serial line."""
        ...

    @property
    def user(self) -> str:
        """User of a caster."""
        ...

    @property
    def password_env(self) -> str:
        """Name of the environment variable that holds the password."""
        ...


def source_of_link(
    link: Addressed,
    environment: Mapping[str, str] = os.environ,
    position: Callable[[], bytes] | None = None,
) -> Source:
    """Return the source of a link.

    raises ConfigurationError: when the address cannot be meant or the password is missing.
    """
    address = ntrip_address(link.url)
    if address is None:
        return source_of(link.url, link.baud)
    password = ""
    if link.password_env:
        if link.password_env not in environment:
            raise ConfigurationError(
                f"the environment variable {link.password_env} with the password is not set",
                where=link.url,
                remedy="set it before recording",
            )
        password = environment[link.password_env]
    return NtripSource(address, link.user, password, position=position)
