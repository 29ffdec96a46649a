"""Known answers, for tests and benchmarks: exact and manufactured solutions, finite elements.

What has an answer stands here together with the answer: a body that is bent, shaken or refined
must still give it.
"""
