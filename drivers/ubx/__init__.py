"""u-blox UBX: framing, decoding by numpy views and encoding."""
