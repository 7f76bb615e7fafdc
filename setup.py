"""What pyproject.toml cannot say: the studies of configs/ go along with all their folders."""

from pathlib import Path

from setuptools import setup

STUDIES = Path("configs/studies")
folders = sorted(path for path in [STUDIES, *STUDIES.rglob("*")] if path.is_dir())
setup(
    data_files=[
        (
            f"share/photocal/{folder.relative_to('configs').as_posix()}",
            sorted(path.as_posix() for path in folder.iterdir() if path.is_file()),
        )
        for folder in folders
    ]
)
