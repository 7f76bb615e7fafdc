"""Ways for bytes to go out to programs and devices and to come in."""
