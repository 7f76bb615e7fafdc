"""Flights that never took place, for demonstrations and tests; they say so themselves."""
