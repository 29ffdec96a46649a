"""More points, smaller error bars: the force on a glued cube beside that of finite elements."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

from myork import Results, load_deck, run_deck

DECK = Path(__file__).parents[1] / "inputs" / "cube_plates.toml"
POINTS = (5, 7, 9)

force, bar = [], []
for n in POINTS:
    with TemporaryDirectory() as folder:
        run_deck(DECK, folder, overrides=[f"geometry.source=[{n},{n},{n}]"])
        with Results(folder) as results:
            last = results.summary["steps"][-1]
    force.append(last["probes"]["force"])
    bar.append(last["probe_errors"]["force"])
    print(f"{n} points along an edge: {force[-1]:.2f} +- {bar[-1]:.2f} N")
reference = load_deck(DECK)["reference"][0]
plt.errorbar(POINTS, force, bar, fmt="o", capsize=4)
plt.axhline(reference["value"][0], color="k", ls="--", label="finite elements")
plt.xticks(POINTS)
plt.xlabel("points along an edge")
plt.ylabel("force [N]")
plt.legend()
plt.savefig(sys.argv[1], dpi=100)
