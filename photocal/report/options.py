"""Options of `photocal certificate`."""

import datetime as dt
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options


@dataclass(frozen=True, kw_only=True)
class CertificateOptions(Options):
    """Language, date and particulars of a certificate."""

    language: Annotated[
        str,
        Option("Language of the texts: en or pt-BR; default: that of LANG.", ("--lang", "--language")),
    ] = ""
    date: Annotated[str | None, Option("Day of the certificate, YYYY-MM-DD; today if not given.")] = None
    block: Annotated[
        Path | None,
        Option(
            "Block folder of the run, or its set-up file, when it is not found near it: the certificate "
            "includes the inputs for `photocal verify`."
        ),
    ] = None
    particulars: Annotated[
        Path | None,
        Option("TOML file: camera, campaign, positioning system, equipment, validity, responsible."),
    ] = None
    client: Annotated[str, Option("Client.")] = ""
    operator: Annotated[str, Option("Operator: who carried out the calibration.")] = ""
    form: Annotated[
        str, Option("Form to be filled in, too: br-md, of the Brazilian Ministry of Defence.")
    ] = ""
    images: Annotated[
        Path | None, Option("Folder of the pictures: their EXIF gives camera, aperture, focus and firmware.")
    ] = None

    def day(self) -> dt.date:
        """Give the day of the certificate, today by default; ConfigurationError for an invalid date."""
        if self.date is None:
            return dt.datetime.now().astimezone().date()
        try:
            return dt.date.fromisoformat(self.date)
        except ValueError:
            raise ConfigurationError(
                f"{self.date!r} is not a date", "write it as YYYY-MM-DD", where="--date"
            ) from None
