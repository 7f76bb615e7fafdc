"""A zip that was sent and damaged on the way: refused, whichever of its bytes are wrong."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from photocal.base.errors import PhotocalError
from photocal.desk.certificate import verify


def test_a_damaged_zip_is_refused() -> None:
    rng = np.random.default_rng(2)
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("certificate/figures.txt", rng.integers(48, 58, 2000, np.uint8).tobytes())
    for place in range(0, len(whole.getvalue()), 5):
        spoilt = bytearray(whole.getvalue())
        spoilt[place : place + 3] = rng.bytes(3)
        # Where the damage is in a date, what is missing is the certificate.
        with pytest.raises(PhotocalError):
            verify(bytes(spoilt))
