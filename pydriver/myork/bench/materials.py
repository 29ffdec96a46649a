"""Materials of Basava (2015) as tables of a deck."""

#: Muscle of table 4.1, per N/cm2
MUSCLE = {
    "name": "muscle",
    "model": "muscle",
    "A10": 6.43,
    "A01": -3.8,
    "A20": 0.94,
    "A02": 0.0005,
    "A11": -0.0043,
    "K": 5e3,
}
#: Rubber of section 5.3.10 with its own bulk modulus, per N/cm2
RUBBER = {"name": "rubber", "model": "polynomial", "A10": 37.3, "A20": -3.1, "A30": 0.5, "K": 5e3}
