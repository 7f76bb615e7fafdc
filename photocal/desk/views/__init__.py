"""What step Look shows of a project that was run: arrays and plain values made of its results."""
