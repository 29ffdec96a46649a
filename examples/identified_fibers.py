"""The rate at which passive fibers stiffen, from a measured curve, with its confidence interval."""

import csv
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

from myork.studies import identify

DATA = Path(__file__).parent / "data" / "tomalka_2017_figure_2.csv"
OPTIMUM, SIGMA = 2.46, 30  # [um], [N/cm^2], as in measured_fibers.py
DECK = """\
units = { force = "N", length = "cm" }
scene = { dimension = 3, method = "rkpm-gauss" }
geometry = { kind = "box", size = [1, 1, 1], source = [3, 3, 3] }
material = [{ name = "m", model = "muscle", A10 = 0.1, K = 500, fiber = [0, 0, 1] }]
boundary = [{ set = "x0", u_x = 0 }, { set = "y0", u_y = 0 },
            { set = "z0", u_z = 0 }, { set = "z1", u_z = 0.1 }]
probe = [{ name = "pull", quantity = "force_z", set = "z1" }]
"""
with TemporaryDirectory() as name, DATA.open() as lines:
    rows = csv.reader(line for line in lines if line.startswith("passive"))
    data = np.array([row[1:] for row in rows], float) * [1 / OPTIMUM, SIGMA] - [1, 0]
    deck, table = Path(name, "fiber.toml"), Path(name, "m.csv")
    deck.write_text(DECK)
    np.savetxt(table, data[data[:, 0] > 0], "%.6g", ",", header="boundary.z1.u_z,pull", comments="")
    found = identify(deck, table, ["material.m.gamma2=1:7"], name)
    fit = np.genfromtxt(Path(name, "identify.csv"), delimiter=",", names=True)
for key, entry in found["parameters"].items():
    print("{}: {:.3g}, 95 % from {:.3g} to {:.3g}".format(key, entry["value"], *entry["interval"]))
strain, measured, fitted = np.transpose(fit.tolist())
plt.plot(strain, measured, "o", label="measured")
plt.plot(strain, fitted, label="fitted")
plt.xlabel("strain of the fibers")
plt.ylabel("passive stress [N/cm^2]")
plt.legend()
plt.savefig(sys.argv[1], dpi=100)
