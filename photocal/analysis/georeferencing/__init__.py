"""The same block georeferenced directly, integrated and indirectly, and judged at its ground points."""
