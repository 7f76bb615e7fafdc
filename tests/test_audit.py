"""The audit of what is delivered: what it calls locked, and which licences it lets pass."""

from __future__ import annotations

import pytest

from tests.audit import LOCK, fits, locked


def test_every_package_is_locked_by_its_hashes() -> None:
    packages = locked(LOCK.read_text(encoding="utf-8"))
    assert {"numpy", "scipy", "pymavlink", "cryptography"} <= packages.keys()
    assert all(hashes > 0 for _, hashes in packages.values())


def test_a_lock_without_hashes_is_seen() -> None:
    assert locked("a==1.0 \\\n    --hash=sha256:00\nB_b==2\n") == {"a": ("1.0", 1), "b-b": ("2", 0)}


@pytest.mark.parametrize(
    ("stated", "fit"),
    [
        ("MIT", True),
        ("BSD-3-Clause AND 0BSD AND MIT AND Zlib AND CC0-1.0", True),
        ("GPL-3.0-only", False),
        ("GPL-3.0-only OR MIT", True),
        ("MIT AND GPL-3.0-only", False),
        ("GNU Affero General Public License v3", False),
        ("not stated", False),
    ],
)
def test_licences(stated: str, fit: bool) -> None:
    assert fits(stated) is fit
