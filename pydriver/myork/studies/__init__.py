"""Studies: which parameters fit measurements."""

from myork.studies.identify import identify

__all__ = ["identify"]
