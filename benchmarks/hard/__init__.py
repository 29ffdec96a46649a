"""Hard cases of `tests/verification/test_stability.py`, and how what comes out is judged."""
