"""One self-contained page from the files in an output folder; reads, never solves."""

from myork.report.page import compare_runs, make_report

__all__ = ["compare_runs", "make_report"]
