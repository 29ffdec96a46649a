"""Segmentation: from an image to labels, and how good they are."""
