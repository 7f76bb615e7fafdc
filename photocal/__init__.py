"""The processing side: from flight log, images and control to a calibrated camera and its certificate."""
