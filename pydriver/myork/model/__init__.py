"""Models: from labels and fibers to points with boundary sets and normals."""
