"""The block, its result and its project: as data, and as folders of plain files."""
