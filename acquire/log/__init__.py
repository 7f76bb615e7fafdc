"""The flight log: raw frames first, everything decoded beside them, in one MCAP file."""
