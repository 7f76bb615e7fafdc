"""A hypothesis as a stranger would bring it: positions that are shifted to the north alone."""

from photocal.hypotheses.table import AddedFault, Fault

FAULT = AddedFault(
    words={
        "en": {
            "term.north-shift": "a shift to the north",
            "finding.north-shift": "All positions lie too far north, as if an axis of the base were mistyped",
            "remedy.north-shift": "Read the northing of the base once more.",
        }
    },
    fault=Fault("north-shift", ("positions",), ("shift_y",), prior=1000.0),
)
