"""Which parameters matter for the deflection of a beam: Sobol's indices of full solves."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

from myork.studies import sensitivity

DECK = Path(__file__).parents[1] / "inputs" / "cantilever_load.toml"
SMALL = ["geometry.source=[17,5]"]
VARY = ["material.rubber.A10=30:45", "material.rubber.K=500:2000", "material.rubber.A20=-4:-2"]

with TemporaryDirectory() as folder:
    found = sensitivity(DECK, folder, vary=VARY, fixed=SMALL, samples=32, probe="tip")
indices = found["indices"].values()
names = [key.rpartition(".")[2] for key in found["indices"]]
for shift, kind, label in ((-0.2, "first_order", "alone"), (0.2, "total_order", "in all")):
    value, low, high = (np.array([entry[kind][end] for entry in indices])
                        for end in ("value", "low", "high"))  # fmt: skip
    bars = np.maximum([value - low, high - value], 0)
    plt.bar(np.arange(len(names)) + shift, value, 0.4, yerr=bars, capsize=4, label=label)
    print(label, *(f"{name} {number:.2f}" for name, number in zip(names, value, strict=True)))
plt.xticks(range(len(names)), names)
plt.ylabel("share of the variance of the tip's deflection")
plt.legend()
plt.savefig(sys.argv[1], dpi=100)
