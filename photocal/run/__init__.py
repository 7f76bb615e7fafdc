"""From flight log, images and control points to the certificate, in stages that are kept by content."""
