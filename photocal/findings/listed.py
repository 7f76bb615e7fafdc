"""Findings in a file and as a table."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from photocal.base.codec import object_of, parsed_json
from photocal.base.files import output_file, write_json
from photocal.base.tables import package
from photocal.findings.finding import Finding
from photocal.findings.texts import as_record, catalogue, finding_text, findings_of, plain

SCHEMA = "photocal.findings/1"


@dataclass(frozen=True, repr=False)
class Findings:
    """What checks found, in the order in which it is reported.

    Attributes
    ----------
    listed
        The findings.
    """

    listed: tuple[Finding, ...] = ()

    def __len__(self) -> int:
        return len(self.listed)

    def __iter__(self) -> Iterator[Finding]:
        return iter(self.listed)

    def __repr__(self) -> str:
        """Say each in a line."""
        say = catalogue("en")
        lines = [f"{one.severity}: {one.code}: {finding_text(one, say, plain)}" for one in self]
        return "\n".join(lines) or "no findings"

    @staticmethod
    def read(path: str | Path) -> "Findings":
        """Read the findings of a record: what `write` wrote, or a JSON file of a stage.

        Parameters
        ----------
        path
            JSON file with a list `findings`; without it there are none.

        Returns
        -------
        Findings
            As they were when they were written.

        Raises
        ------
        InputNotFoundError, InputMalformedError
            For a file that is missing, or no record of this version.
        """
        path, remedy = Path(path), "run the stage again"
        record = object_of(dict[str, Any], parsed_json(path, remedy), path, remedy)
        return Findings(findings_of(record.get("findings"), path))

    def write(self, path: str | Path) -> None:
        """Write a JSON file: each finding with its figures, and the warnings among them as sentences.

        Parameters
        ----------
        path
            File that takes the place of an older one.

        Raises
        ------
        OutputError
            When it cannot be written.
        """
        with output_file(Path(path)) as aside:
            write_json(aside, {"schema": SCHEMA, **as_record(self.listed)})

    def to_arrow(self) -> Any:
        """Give a `pyarrow.Table`: code, severity, subject, cause, stage and words of each."""
        pa, say = package("pyarrow"), catalogue("en")
        names = ("code", "severity", "subject", "cause", "stage")
        columns = {name: [getattr(one, name) for one in self] for name in names}
        columns["text"] = [finding_text(one, say, plain) for one in self]
        return pa.table({name: pa.array(values, pa.string()) for name, values in columns.items()})

    def to_pandas(self) -> Any:
        """Give the table of `to_arrow` as a DataFrame; ProgramMissingError where pandas is not installed."""
        package("pandas")
        return self.to_arrow().to_pandas()
