"""Known answers of problems: manufactured solutions, finite elements, transformed bodies.

Bodies with a known answer are defined here together with the answer: a bent, perturbed or refined
body must still give it. Closed forms are in `exact`.
"""
