"""The one result of an adjustment: made, written and read here, looked at by everybody above."""
