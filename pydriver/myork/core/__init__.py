"""The compiled core: what Python hands to it and gets from it; only this room imports it."""
