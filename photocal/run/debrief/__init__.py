"""The verdict at the field's edge: whether a flight is complete, or what must be flown again."""
