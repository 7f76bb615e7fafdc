"""`check --moments`: the same tests and classes from moments as from points."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from photocal.analysis.accuracy.output import read_moments
from tests.photocal.conftest import Answer

ASKED = ("--standard", "decree-89817", "--scale", "1:1000", "--interval", "1", "--json")


def test_moments_say_what_their_points_say(photocal: Callable[..., Answer], tmp_path: Path) -> None:
    random = np.random.default_rng(8)
    d = random.normal([0.05, -0.02, 0.1], [0.1, 0.12, 0.2], (20, 3))
    points = [f"p{k},{e!r},{n!r},{h!r}" for k, (e, n, h) in enumerate(d.tolist())]
    (tmp_path / "points.csv").write_text("point,dE,dN,dh\n" + "\n".join(points) + "\n", encoding="utf-8")
    mean, std = d.mean(axis=0).tolist(), d.std(axis=0, ddof=1).tolist()
    rows = [f"{c},20,{m!r},{s!r}" for c, m, s in zip("ENh", mean, std, strict=True)]
    (tmp_path / "moments.csv").write_text(
        "component,n,mean_m,std_m\n" + "\n".join(rows) + "\n", encoding="utf-8"
    )
    rmse = np.sqrt(np.mean(d**2, axis=0)).tolist()
    t = [m / s * 20**0.5 for m, s in zip(mean, std, strict=True)]
    rows = [f"{c},20,{r!r},{v!r}" for c, r, v in zip("ENh", rmse, t, strict=True)]
    (tmp_path / "rmse.csv").write_text("component,n,rmse_m,t\n" + "\n".join(rows) + "\n", encoding="utf-8")
    own = photocal("check", "--moments", tmp_path / "moments.csv", "--lang", "pt-BR").out
    assert own.startswith("momentos como publicados; as discrepâncias são produto menos referência")
    of_points = json.loads(photocal("check", "--discrepancies", tmp_path / "points.csv", *ASKED).out)
    for name in ("moments.csv", "rmse.csv"):
        (made,) = json.loads(photocal("check", "--moments", tmp_path / name, *ASKED).out)["sets"]
        for component in "ENh":
            ours, theirs = made["components"][component], of_points["components"][component]
            for key in ("mean_m", "std_m", "rmse_m", "rmse_after_trend_removal_m"):
                assert ours[key] == pytest.approx(theirs[key], rel=1e-9), key
            assert ours["bias_test"]["t"] == pytest.approx(theirs["bias_test"]["t"], rel=1e-9)
        for ours, theirs in zip(made["standards"], of_points["standards"], strict=True):
            assert ours["precision_class"] == theirs["precision_class"]
            assert ours["classes"][0]["chi_squared"] == pytest.approx(theirs["classes"][0]["chi_squared"])
            assert ours["classes"][0]["share_within_pec"] is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("component,n\nE,9\n", "has no moments"),
        ("component,n,mean_m,std_m\nE,9,0.1,0.1\n", "only one of E and N"),
        ("component,n,mean_m,std_m\nh,1,0.1,0.1\n", "whole number of at least 2"),
        ("component,n,mean_m,std_m\nh,9,0.1,-0.1\n", "std_m is negative"),
        ("component,n,mean_m,std_m\nz,9,0.1,0.1\n", "component is not known"),
        ("component,n,mean_m,std_m\nh,9,0.1,0.1\nh,9,0.1,0.1\n", "appears twice"),
    ],
)
def test_what_are_no_moments(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "m.csv").write_text(text, encoding="utf-8")
    with pytest.raises(Exception, match=message):
        read_moments(tmp_path / "m.csv")
