"""The rate at which passive fibers stiffen, from a measured curve, with its confidence interval."""

import csv
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import curve_fit
from scipy.stats import t

from myork import Scene

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
with DATA.open() as lines:
    rows = csv.reader(line for line in lines if line.startswith("passive"))
    data = np.array([row[1:] for row in rows], float) * [1 / OPTIMUM, SIGMA] - [1, 0]
strain, measured = data[data[:, 0] > 0].T


def stress(strains, gamma2):
    """Passive stress at strains of the fibers [N/cm^2]."""
    found = []
    for strain in strains:
        scene.update({"material.m.gamma2": gamma2, "boundary.z1.u_z": strain})
        states = scene.solve(error=False)
        found.append(scene.probes(states.x[-1:], states.load[-1:])[0, 0, 0])
    return found


with Scene.from_tables(DECK) as scene:
    (value,), ((variance,),) = curve_fit(
        stress, strain, measured, p0=[4], bounds=(1, 7), diff_step=1e-3
    )
    half = t.ppf(0.975, len(strain) - 1) * variance**0.5
    print(f"gamma2: {value:.3g}, 95 % from {value - half:.3g} to {value + half:.3g}")
    fitted = stress(strain, value)
plt.plot(strain, measured, "o", label="measured")
plt.plot(strain, fitted, label="fitted")
plt.xlabel("strain of the fibers")
plt.ylabel("passive stress [N/cm^2]")
plt.legend()
plt.savefig(sys.argv[1], dpi=100)
