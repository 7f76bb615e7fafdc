"""Options defined once: as arguments of a command, keys of a file, and in Python."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
from typer.testing import CliRunner

from photocal.base.checked_toml import Table, read_toml
from photocal.base.console import application, argument, option, spread
from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options


@dataclass(frozen=True, kw_only=True)
class Baking(Options):
    """How bread is baked."""

    minutes: Annotated[float, Option("Time in the oven, min.")] = 40.0
    seeds: Annotated[tuple[str, ...], Option("Seeds upon it.")] = ()
    list_of: Annotated[Path | None, Option("Recipe.", ("-r", "--recipe"))] = None

    def __post_init__(self) -> None:
        if self.minutes <= 0:
            raise ConfigurationError("--minutes is not positive", "give minutes")


class Recipe(Table):
    """A file with a table of options."""

    baking: Baking = Baking()


def _bread() -> tuple[list[tuple[str, Baking, bool]], object]:
    made: list[tuple[str, Baking, bool]] = []
    app = application("Bread.")

    @spread
    def bake(
        name: Annotated[str, argument("Name.")],
        *,
        options: Baking,
        hot: Annotated[bool, option("Hot.", "--hot")] = False,
    ) -> None:
        """Bake."""
        made.append((name, options, hot))

    app.command()(bake)
    return made, app


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["rye"], ("rye", Baking(), False)),
        (
            ["rye", "--minutes", "50", "--seeds", "oat", "--seeds", "flax", "-r", "a b.txt", "--hot"],
            ("rye", Baking(minutes=50.0, seeds=("oat", "flax"), list_of=Path("a b.txt")), True),
        ),
    ],
)
def test_a_command_gives_its_function_the_options(
    arguments: list[str], expected: tuple[str, Baking, bool]
) -> None:
    made, app = _bread()
    said = CliRunner().invoke(app, arguments)  # type: ignore[arg-type]
    assert said.exit_code == 0, said.output
    assert made == [expected]


def test_the_help_tells_name_unit_and_default_in_the_order_of_the_signature() -> None:
    said = CliRunner().invoke(_bread()[1], ["--help"]).output  # type: ignore[arg-type]
    assert "Time in the oven, min." in said
    assert "[default: 40.0]" in said
    assert "-r, --recipe" in said
    assert "--list-of" not in said
    assert said.index("--minutes") < said.index("--seeds") < said.index("--hot")


def test_a_file_takes_the_same_options_and_refuses_other_keys(tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text('[baking]\nminutes = 30.0\nseeds = ["oat"]\n')
    assert read_toml(path, Recipe).baking == Baking(minutes=30.0, seeds=("oat",))
    path.write_text("[baking]\nminute = 30.0\n")
    with pytest.raises(ConfigurationError, match=r"unknown key baking\.minute"):
        read_toml(path, Recipe)


def test_values_that_fit_no_other_are_refused_on_every_way() -> None:
    with pytest.raises(ConfigurationError, match="not positive"):
        Baking(minutes=0.0)
    made, app = _bread()
    said = CliRunner().invoke(app, ["rye", "--minutes", "0"])  # type: ignore[arg-type]
    assert isinstance(said.exception, ConfigurationError)
    assert made == []
