"""The one result of an adjustment: made, written and read here, used by all modules above."""
