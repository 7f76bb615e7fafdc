"""MAVLink 1 and 2: framing, tables of messages, decoding by numpy and encoding."""
