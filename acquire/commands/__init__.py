"""One module per command; what computes is imported inside, so that `--help` answers at once."""
