"""Tables that `benchmarks/choices.py` prints: functions that give a head, then rows."""
