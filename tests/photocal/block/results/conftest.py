"""Run folders, as the certificates take them."""

from __future__ import annotations

from tests.photocal.report.conftest import published_folder, run_folder

__all__ = ["published_folder", "run_folder"]
