"""Benchmarks of a checkout: answers, error bars, verdicts and costs compared with finite elements.

`runner.py` solves problems with several forms and sizes and keeps one row per solve; `pivots.py`
has the views of such rows. `myork bench NAME` runs them in the folder that contains this one. The
tables of docs/ with other comparisons are functions in `tables`.
"""
