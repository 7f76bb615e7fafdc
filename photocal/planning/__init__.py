"""Before the flight: heights, overlaps, expected precision, error budget, strips and missions."""
