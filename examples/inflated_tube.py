"""A tube under a pressure that follows its wall."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

from myork import Results, run_deck

DECK = Path(__file__).parents[1] / "inputs" / "pressure_follower.toml"

with TemporaryDirectory() as folder:
    run_deck(DECK, Path(folder), overrides=["load.steps=5"])
    with Results(folder) as results:
        last = results.summary["steps"][-1]
        points, stress = results.deformed(-1), results.field("principal_stress", -1).max(axis=1)
    hoop, bar = last["probes"]["hoop"], last["probe_errors"]["hoop"]
    print(f"{results.summary['verdict']['state']}: hoop force {hoop:.4f} +- {bar:.1g} N/cm")
where = plt.scatter(points[:, 0], points[:, 1], c=stress, s=60)
plt.colorbar(where, label="largest principal stress [N/cm^2]")
plt.gca().set_aspect("equal")
plt.xlabel("x [cm]")
plt.ylabel("y [cm]")
plt.savefig(sys.argv[1], dpi=100)
