"""Images: files, geometry of their grids, and a phantom with a known answer."""
