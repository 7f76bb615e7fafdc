"""Recording of a flight: every link raw first, on disk within a second."""
