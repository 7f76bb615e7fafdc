"""Start values of exposures and object points from image points and a little control."""
