"""Parameter sweeps of a deck: points of its keys, solved side by side, in one table."""

from myork.sweeps.run import sweep

__all__ = ["sweep"]
