"""What a result is worth: significance, stability, hidden errors, georeferencing, check points."""
