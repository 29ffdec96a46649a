"""A field of all load steps: stress of a muscle, stretched and then activated."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

from myork import Results, run_deck

DECK = Path(__file__).parents[1] / "inputs" / "stretch_then_activate.toml"
COARSE = ["geometry.source=[4,4,7]", "geometry.collocation=[7,7,13]", "load.activation=0.2"]

with TemporaryDirectory() as folder:
    run_deck(DECK, Path(folder), overrides=COARSE)
    with Results(folder) as results:
        cauchy = np.stack([results.field("cauchy", step) for step in range(results.nstep)])
        loads, summary = results.loads, results.summary
        print(summary["verdict"]["state"])
low, middle, high = np.quantile(cauchy[:, :, 2, 2], [0.05, 0.5, 0.95], axis=1)
unit = summary["units"]["stress"]
print(f"fiber stress {middle[-1]:.2f}, 90 % from {low[-1]:.2f} to {high[-1]:.2f} {unit}")
plt.fill_between(loads, low, high, alpha=0.3, label="90 % of the points")
plt.plot(loads, middle, "o-", label="median")
plt.xlabel("load time: stretched until 0.4, then activated")
plt.ylabel(f"stress along the fibers [{unit}]")
plt.legend()
plt.savefig(sys.argv[1], dpi=100)
