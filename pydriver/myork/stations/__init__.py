"""Stations from an image to a solution.

Each is a function `station(deck, out, *, overrides, threads, progress)`. It takes a deck, as a file
or as tables, and a folder for files and for a part of `summary.json`, which it returns.
"""
