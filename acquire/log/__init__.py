"""The flight log: MCAP files with each frame as it came over the wire and what was decoded."""
