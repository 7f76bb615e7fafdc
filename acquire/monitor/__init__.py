"""The live view of a recording: one state, folded from the flight log as it grows, and its views."""
