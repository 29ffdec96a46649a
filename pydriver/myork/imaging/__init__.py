"""Images: files, geometry of their grids, and a phantom with known ground truth."""
