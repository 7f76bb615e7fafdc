"""The block: cameras, images, points and observations, as data and as a folder of plain files."""
