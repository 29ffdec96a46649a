"""One self-contained page from the files in an output folder; it reads only, without solving."""

from myork.report.page import make_report

__all__ = ["make_report"]
