"""What the flight log holds beside the raw frames: made from them, the same each time."""
