"""The rate at which passive fibers stiffen, from a measured curve, with its confidence interval."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import curve_fit
from scipy.stats import t

from myork import Scene

DATA = Path(__file__).parent / "data" / "tomalka_2017_figure_2.csv"
OPTIMUM, SIGMA = 2.46, 30  # [um], [N/cm^2], as in measured_fibers.py
scene = Scene.from_tables("""
units = { force = "N", length = "cm" }
scene = { dimension = 3, method = "rkpm-gauss" }
geometry = { kind = "box", size = [1, 1, 1], source = [3, 3, 3] }
material = [{ name = "m", model = "muscle", A10 = 0.1, K = 500, fiber = [0, 0, 1] }]
boundary = [{ set = "x0", u_x = 0 }, { set = "y0", u_y = 0 },
            { set = "z0", u_z = 0 }, { set = "z1", u_z = 0.1 }]
probe = [{ name = "pull", quantity = "force_z", set = "z1" }]""")


def stress(strain, gamma2):
    """Passive stress at a strain of the fibers [N/cm^2]."""
    scene.update({"material.m.gamma2": gamma2, "boundary.z1.u_z": strain})
    states = scene.solve(error=False)
    return scene.probes(states.x[-1:], states.load[-1:])[0, 0, 0]


rows = [line.split(",")[1:] for line in DATA.read_text().splitlines() if line[:7] == "passive"]
strains, measured = (np.array(rows, float) * [1 / OPTIMUM, SIGMA] - [1, 0]).T
strains, measured = strains[strains > 0], measured[strains > 0]
(best,), deviation = curve_fit(np.vectorize(stress), strains, measured, [4], bounds=(1, 7))
low, high = t.interval(0.95, len(strains) - 1, best, deviation[0, 0] ** 0.5)
print(f"gamma2: {best:.3g}, 95 % from {low:.3g} to {high:.3g}")
plt.plot(strains, measured, "o", strains, np.vectorize(stress)(strains, best))
plt.gca().set(xlabel="strain of the fibers", ylabel="passive stress [N/cm^2]")
plt.savefig(sys.argv[1], dpi=100)
