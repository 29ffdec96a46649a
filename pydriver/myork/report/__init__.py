"""One self-contained page from the files in an output folder; reads, never solves."""

from myork.report.page import make_report

__all__ = ["make_report"]
