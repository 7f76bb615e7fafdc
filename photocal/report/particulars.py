"""What a certificate says that no adjustment knows: for whom, by whom, when."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass


@dataclass(frozen=True)
class Particulars:
    """Given by a person, not computed.

    Attributes
    ----------
    date : date
        Day of the certificate.
    client, operator : str
        For whom and by whom; may be empty.
    """

    date: dt.date
    client: str = ""
    operator: str = ""
