"""Tables that `benchmarks/runner.py` prints: functions that yield a header, then rows."""
