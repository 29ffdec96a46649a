"""Stations of the way from an image to a solution.

Each is a function `station(deck, out, *, overrides, threads, progress)`: a deck, as a file or as
tables, and a folder for files and for a part of `summary.json`, which it returns.
"""
