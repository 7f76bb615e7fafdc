"""`photocal analyse` from a run folder to its answer."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import photocal
from photocal.adjustment.adjusted import fit
from photocal.adjustment.ledger import ledger
from photocal.analysis.analyse_run import analyse_run
from photocal.analysis.estimates import quadratic_form, without
from photocal.analysis.left_out import Checks, left_out
from photocal.analysis.outcome import Analysis
from photocal.analysis.systematic_errors.search import camera_estimates
from photocal.base.arrays import as_plain
from photocal.base.errors import InputMalformedError, InputNotFoundError
from photocal.block.folder import read_block
from photocal.block.network import assemble
from photocal.block.results.adjusted import adjust_block
from photocal.block.results.folder import block_of_run, read_result
from photocal.commands.cli import app
from photocal.geometry.camera import PARAMETERS
from photocal.report.stored_analysis import read_run


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, dcs460_block: Path) -> Path:
    """Folder with the block and a run of it, side by side."""
    folder = tmp_path_factory.mktemp("made")
    shutil.copytree(dcs460_block, folder / "block")
    adjust_block(folder / "block", folder / "run")
    return folder


def test_json(made: Path) -> None:
    done = CliRunner().invoke(app, ["analyse", str(made / "run"), "--json"])
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    assert next(iter(figures)) == "schema"
    assert figures["findings"][0]["kind"] == "y-scale"
    assert figures["findings"][0]["figure"] == pytest.approx(0.99804, abs=1e-4)
    assert figures["findings"][0]["effect_c"] == pytest.approx(0.028, abs=5e-4)
    own = figures["cameras"]["dcs460"]
    k3 = next(test for test in own["significance"] if test["parameters"] == ["K3"])
    # The source's own figures: t = 5.6, though its text calls K3 insignificant.
    assert k3["statistic"] * own["variance_factor_of_tests"] == pytest.approx(5.64**2, rel=5e-3)
    assert figures["jackknife"]["dcs460"]["standard_error"]["c"] == pytest.approx(0.058, abs=5e-4)
    assert {one["method"] for one in figures["methods"] if one["met"]} >= {"convergent", "self-calibration"}


def test_words(made: Path) -> None:
    done = CliRunner().invoke(app, ["analyse", str(made / "run"), "--details"])
    assert done.exit_code == 0, done.output
    # The verdict comes first, then the details that were asked for.
    assert done.stdout.startswith("Verdict\n")
    _, hidden = done.stdout.split("\nHidden systematic errors\n")
    assert re.search(r"^large +Camera dcs460: y scale factor 0\.9980", hidden, re.MULTILINE)
    for words in ("K1 K2 K3", "Adjusted again without", "convergent cameras: satisfied"):
        assert words in done.stdout
    assert re.search(r"^x0–P1 +0\.87", done.stdout, re.MULTILINE)


def test_the_block_is_recognised_by_its_hashes(made: Path, tmp_path: Path) -> None:
    result = read_result(made / "run")
    assert result.block.source == "../block"
    found = block_of_run(made / "run", result, None, tmp_path)
    assert found.path.samefile(made / "block")
    assert block_of_run(made / "run", result, made / "block", tmp_path).path == made / "block"
    far = tmp_path / "a/b/c"
    shutil.copytree(made / "block", far)
    shutil.copytree(made / "run", tmp_path / "elsewhere/run")
    assert block_of_run(tmp_path / "elsewhere/run", result, None, tmp_path).path == far


def test_a_changed_block_is_named(made: Path, tmp_path: Path) -> None:
    result = read_result(made / "run")
    changed = tmp_path / "block"
    shutil.copytree(made / "block", changed)
    points = (changed / "points.csv").read_text()
    (changed / "points.csv").write_text(points.replace("6.327", "6.328", 1))
    with pytest.raises(InputMalformedError, match=r"points.csv: is not the file that the run was made from"):
        block_of_run(made / "run", result, changed, tmp_path)
    shutil.copytree(made / "run", tmp_path / "run")
    with pytest.raises(InputNotFoundError, match="name it with --block"):
        block_of_run(tmp_path / "run", result, None, tmp_path)


def test_an_analysis_of_another_run_is_refused(made: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(made / "run", run)
    done = CliRunner().invoke(app, ["analyse", str(run), "--block", str(made / "block")])
    assert done.exit_code == 0, done.output
    stored = read_run(run).analysis
    assert stored is not None
    assert [one.code for one in stored.findings][:3] == ["y-scale", "c-bias", "observation-sigma"]
    as_written = (run / "result.json").read_text()
    (run / "result.json").write_text(as_written.replace('"iterations"', '"iterations" '))
    assert (run / "result.json").read_text() != as_written
    with pytest.raises(InputMalformedError, match="belongs to another run"):
        read_run(run)


def test_an_analysis_comes_back_as_it_was(made: Path, tmp_path: Path) -> None:
    """What is read is what was computed, also where a figure does not exist; schema 1 is refused."""
    run = tmp_path / "run"
    shutil.copytree(made / "run", run)
    outcome = analyse_run(run, made / "block")
    stored = read_run(run).analysis
    assert stored is not None
    assert as_plain(stored) == as_plain(
        Analysis(**{f.name: getattr(outcome, f.name) for f in fields(Analysis)})
    )
    judged, back = outcome.cameras["dcs460"], stored.cameras["dcs460"]
    assert judged is not None
    assert back is not None
    np.testing.assert_array_equal(judged.components.final.loadings, back.components.final.loadings)
    assert np.isnan(back.effects[1].largest_px) == np.isnan(judged.effects[1].largest_px)
    text = (run / "analysis.json").read_text()
    (run / "analysis.json").write_text(text.replace('"alpha": 0.1', '"alpha": "a tenth"'))
    with pytest.raises(InputMalformedError, match="alpha: 'a tenth' found where"):
        read_run(run)
    (run / "analysis.json").write_text(text.replace("photocal.analysis/2", "photocal.analysis/1"))
    with pytest.raises(InputMalformedError, match=r"analysis/1.*run `photocal analyse` again"):
        read_run(run)


def test_portuguese(made: Path) -> None:
    done = CliRunner().invoke(app, ["analyse", str(made / "run"), "--details", "--language", "pt-BR"])
    assert done.exit_code == 0, done.output
    assert "fator de escala em y 0,9980" in done.stdout
    assert "câmeras convergentes: satisfeito" in done.stdout


def test_a_missing_run_is_one_line(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["analyse", str(tmp_path / "nothing")])
    assert isinstance(done.exception, InputNotFoundError)
    assert "\n" not in str(done.exception)


def test_left_out_is_adjusting_without_it(dcs460_block: Path) -> None:
    """Against the network whose camera never had the parameter, and the prediction from the covariance."""
    network = assemble(read_block(dcs460_block)).network
    fitted = fit(network)
    checks = Checks(np.array([0, 5]), network.points.values[[0, 5]])
    outcomes = {one.parameter: one for one in left_out(fitted, 0, checks)}
    assert set(outcomes) == {"x0", "y0", "K1", "K2", "K3", "P1", "P2"}
    own = network.cameras[0]
    estimated = own.estimated.copy()
    estimated[PARAMETERS.index("K3")] = False
    anew = fit(replace(network, cameras=(replace(own, estimated=estimated),))).solution
    k3 = outcomes["K3"]
    assert k3.c == pytest.approx(float(anew.cameras[0, 0]), abs=1e-7)
    assert k3.chi_squared == pytest.approx(anew.chi_squared, abs=1e-4)
    assert k3.sigma0_squared == pytest.approx(anew.variance_factor, rel=1e-9)
    assert k3.check_rmse_m is not None
    moved = anew.points[[0, 5]] - network.points.values[[0, 5]]
    np.testing.assert_allclose(k3.check_rmse_m, np.sqrt(np.mean(moved**2, axis=0)), rtol=1e-4)
    estimates = camera_estimates(fitted, 0)
    predicted, increase = without(estimates, ("K3",)), quadratic_form(estimates.select(["K3"]))
    assert k3.c == pytest.approx(float(predicted.values[0]), abs=2e-4)
    assert k3.chi_squared - fitted.solution.chi_squared == pytest.approx(increase, rel=0.02)


def test_help_names_the_formats() -> None:
    done = CliRunner().invoke(app, ["analyse", "--help"])
    assert done.exit_code == 0


def test_what_was_adjusted_here_is_analysed_as_what_was_read(tmp_path: Path, dcs460_block: Path) -> None:
    """A block that was adjusted here is not adjusted again; figures are those of a result that was read."""
    block = read_block(dcs460_block)
    result = photocal.adjust(block)
    result.write(tmp_path / "run")
    with ledger() as made:
        here = photocal.analyse(block, result)
    assert [entry.reason for entry in made if "calibrated" in entry.reason] == []
    read = photocal.analyse(block, photocal.Result.read(tmp_path / "run"))
    other = photocal.analyse(read_block(dcs460_block), result)
    for one in (read, other):
        assert [finding.code for finding in one.findings] == [finding.code for finding in here.findings]
        for mine, yours in zip(here.cameras.values(), one.cameras.values(), strict=True):
            assert mine is not None
            assert yours is not None
            for test, same in zip(mine.significance, yours.significance, strict=True):
                assert test.statistic == pytest.approx(same.statistic, rel=1e-6)
