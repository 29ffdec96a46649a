"""Tables that `benchmarks/runner.py` prints: functions that give a head, then rows."""
