"""Benchmarks of a checkout: answers, error bars, verdicts and costs beside finite elements.

`runner.py` solves problems by some forms at some sizes and keeps a row a solve; `pivots.py` has the
views of such rows. `myork bench NAME` runs them where it is called in the folder that holds this
one. The tables of docs/ that compare something else are functions in `tables`.
"""
