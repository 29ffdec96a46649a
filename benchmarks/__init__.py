"""Benchmarks of a checkout: answers, error bars, verdicts and costs beside finite elements.

The runner solves problems by some forms at some sizes and keeps a row a solve; the tables of
`trust`, `newcomer`, `certify`, `essential` and `race` are views of such rows. `myork bench NAME`
runs them where it is called in the folder that holds this one. `choices.py NAME` prints one table
of docs/, a function in `tables`.
"""
