"""Known answers of problems: manufactured solutions, finite elements, bodies that keep an answer.

What has an answer stands here together with the answer: a body that is bent, shaken or refined
must still give it. Closed forms are in `exact`.
"""
