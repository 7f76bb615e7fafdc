"""Adoptions whose analysis nobody asks for."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from photocal.adjustment.adjusted import fit
from photocal.block.model import Block
from photocal.block.results.adjusted import network_of, state_of
from photocal.block.results.folder import read_result


def without_analysis(monkeypatch: pytest.MonkeyPatch) -> None:
    """Adjust alone: no search for hidden errors, no certificate."""

    def adjusted(run: Path, source: Path, read: Callable[[Path], Block]) -> SimpleNamespace:
        """Give an outcome that found nothing, with the network at its minimum."""
        result = read_result(run)
        assembly = network_of(read(source), result)
        first = fit(assembly.network, state_of(assembly, result))
        return SimpleNamespace(findings=(), search=SimpleNamespace(first=first))

    monkeypatch.setattr("photocal.analysis.analyse_run.analyse_run", adjusted)
    monkeypatch.setattr("photocal.report.issue.issue", lambda *_, **__: None)
