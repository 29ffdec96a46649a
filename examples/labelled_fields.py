"""Fields of all load steps as labelled arrays: stress of a muscle, stretched and then activated."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

from myork import Results, run_deck

DECK = Path(__file__).parents[1] / "inputs" / "stretch_then_activate.toml"
COARSE = ["geometry.source=[4,4,7]", "geometry.collocation=[7,7,13]", "load.activation=0.2"]

with TemporaryDirectory() as folder:
    run_deck(DECK, Path(folder), overrides=COARSE)
    with Results(folder) as results:
        fields = results.to_xarray("cauchy", "J")
        print(results.summary["verdict"]["state"])
stress = fields.cauchy.sel(i="z", j="z")
low, middle, high = stress.quantile([0.05, 0.5, 0.95], "point")
unit = fields.cauchy.attrs["units"]
print(f"fiber stress {middle[-1]:.2f}, 90 % from {low[-1]:.2f} to {high[-1]:.2f} {unit}")
plt.fill_between(stress["load"], low, high, alpha=0.3, label="90 % of the points")
plt.plot(stress["load"], middle, "o-", label="median")
plt.xlabel("load time: stretched until 0.4, then activated")
plt.ylabel(f"stress along the fibers [{unit}]")
plt.legend()
plt.savefig(sys.argv[1], dpi=100)
