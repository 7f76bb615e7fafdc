"""Study: 500 random sequences of edits, kills and foreign files end as a run from nothing, and lose nothing.

`python -m tests.evidence.stages` writes docs/evidence/stages.md.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.photocal.run.toy_stages import KINDS, sequence

PAGE = Path(__file__).parents[2] / "docs" / "evidence" / "stages.md"
SEQUENCES, EDITS = 500, 12


def main() -> None:
    """Make the sequences and write the page."""
    with tempfile.TemporaryDirectory() as folder:
        failed = [seed for seed in range(SEQUENCES) if sequence(Path(folder) / str(seed), seed, EDITS)]
    lines = [
        "# Stages under random edits",
        "",
        "Made by `python -m tests.evidence.stages`. Three small stages; each reads all files of the",
        f"previous one. A sequence is {EDITS} random edits ({', '.join(KINDS)}). Inputs are changed with",
        "and without their time stamps, files of others are placed among and over those of the stages,",
        "published files are changed and deleted. Some edits are followed by a run, and some of these runs",
        "are killed at a random call to the file system. Right: after a last run every file is that of a",
        "run from nothing in an empty folder. Each file of others is still there, under its name or as",
        "`NAME.kept-1`.",
        "",
        "| sequences | right |",
        "|---|---|",
        f"| {SEQUENCES} | {SEQUENCES - len(failed)} |",
        "",
    ]
    PAGE.write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
