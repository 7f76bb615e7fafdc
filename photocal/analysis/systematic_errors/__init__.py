"""Systematic errors that an adjustment has hidden in its unknowns and residuals."""
