"""Pictures of a real flight, in Portuguese, from their folder to the signed certificate, without a terminal.

The run is stopped in the middle of matching and goes on; then the server is killed and opened again.
"""

from __future__ import annotations

import re
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image

from tests.photocal.desk.watch import serious, watched

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

expect = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (the extra dev has it)"
).expect

# Reduced, so that a test takes seconds: the tags that tell c in pixels are reduced with them.
_REDUCED, _PICTURES = 0.25, 7
_EXIF, _FOCAL_PLANE = 0x8769, (0xA20E, 0xA20F)
_PATIENCE_MS = 900_000


@pytest.fixture
def flight(shared: Path, tmp_path: Path) -> Path:
    """Seven pictures of one strip and its turn, a quarter of their size."""
    folder = tmp_path / "caliterra"
    folder.mkdir()
    for path in sorted((shared / "data" / "flight-caliterra-twelve").glob("*.jpg"))[:_PICTURES]:
        with Image.open(path) as picture:
            exif = picture.getexif()
            tags = exif.get_ifd(_EXIF)
            for key in _FOCAL_PLANE:
                tags[key] = float(tags[key]) * _REDUCED
            size = (round(picture.width * _REDUCED), round(picture.height * _REDUCED))
            picture.resize(size, Image.Resampling.LANCZOS).save(folder / path.name, exif=exif, quality=92)
    return folder


# Pairs of a few small pictures are matched within a second: whoever looks may see what comes after.
_MEASURING = re.compile("associando|orientando")


def stopped_while_measuring(page: Page, folder: Path) -> None:
    """Stop the run while it measures: what was finished stays, and nothing half made."""
    project = (folder / "project.toml").read_bytes()
    page.get_by_role("button", name="Processar", exact=True).click()
    expect(page.locator("ol.stages li[aria-current] .hint")).to_have_text(_MEASURING)
    assert not (held := serious(page)), held
    page.get_by_role("button", name="Parar").click()
    expect(page.locator("main")).to_contain_text("As etapas prontas ficam")
    expect(page.locator("#rail a[href='#/run']")).to_contain_text("interrompido")
    assert not (held := serious(page)), held
    assert (folder / "project.toml").read_bytes() == project
    assert not (folder / "work" / "measurements").exists()
    page.get_by_role("button", name="Continuar").click()


@pytest.mark.timeout(1800)
def test_a_real_flight_is_certified_without_a_terminal(
    browser: Browser, flight: Path, port: int, serve: Callable[[Path], subprocess.Popen[str]]
) -> None:
    context = browser.new_context(viewport={"width": 1366, "height": 768}, locale="pt-BR")
    page = context.new_page()
    page.set_default_timeout(_PATIENCE_MS)
    expect.set_options(timeout=_PATIENCE_MS)
    problems = watched(page, f"http://127.0.0.1:{port}/")
    server = serve(flight)
    page.goto(f"http://127.0.0.1:{port}/")
    page.get_by_role("button", name="Examinar esta pasta").click()
    expect(page.locator(".findings")).to_contain_text("7 imagens")
    # Central Texas: the zone is told by the pictures.
    expect(page.get_by_label("Sistema de coordenadas")).to_have_value("EPSG:32614")
    expect(page.locator(".list [aria-current=true]")).to_contain_text("projeto")
    page.locator("#rail a[href='#/run']").click()
    stopped_while_measuring(page, flight)

    # The run is a process of its own: the window that is opened again finds it.
    expect(page.locator("ol.stages li[aria-current]")).to_be_visible()
    server.send_signal(signal.SIGKILL)
    server.wait()
    expect(page.locator("main [role=alert]")).to_contain_text("inicie photocal desk de novo")
    assert not (held := serious(page)), held
    serve(flight)
    page.reload()
    expect(page.locator(".total .sign")).to_have_text(re.compile("completo"))
    page.get_by_role("link", name="Ir ao certificado").click()
    page.get_by_label("Pessoa ou escritório").fill("Escritório de teste")
    page.get_by_role("button", name="Criar uma chave").click()
    page.get_by_role("button", name="Assinar", exact=True).click()
    expect(page.locator("main .sign.good").first).to_have_text(re.compile("assinado"))
    expect(page.locator("#rail a[href='#/certificate']")).to_contain_text("assinado")
    assert (flight / "work" / "certificate" / "signature.json").is_file()
    assert problems == [], problems
    context.close()
