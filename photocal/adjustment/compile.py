"""Compile the kernels once, at setup, so that the first adjustment does not wait for it."""
