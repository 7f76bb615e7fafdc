"""What may be wrong with a block: one table, one search in closed form, one way to say it."""
