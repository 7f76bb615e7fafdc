"""Marking points in images by hand: predictions, tiles, snapping, residuals, and the page that shows them."""
