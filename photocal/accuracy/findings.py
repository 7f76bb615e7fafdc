"""One finding: a short code for programs and a sentence for people."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that a person should know about data or results.

    Attributes
    ----------
    code : str
        Stable name of the kind of finding, for programs.
    text : str
        What was found, with its figures, and what to do, in one sentence or two.
    """

    code: str
    text: str

    def to_json(self) -> dict[str, str]:
        """Give the finding as a JSON value.

        Returns
        -------
        dict of str
            `code` and `text`.
        """
        return {"code": self.code, "text": self.text}
