"""From images to the observations of a block: targets, tie points and marks."""
