"""Fibers of a rat in an experiment, and a block of muscle with the default curves of fibers."""

import csv
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from myork import Scene

DATA = Path(__file__).parent / "data" / "tomalka_2017_figure_2.csv"
OPTIMUM, SIGMA = 2.46, 30.0  # [um], fitted to the active force; [N/cm^2], the default
MUSCLE = {"name": "muscle", "model": "muscle", "A10": 6.43, "A01": -3.8, "A20": 0.94, "K": 5000}
BLOCK = {
    "scene": {"dimension": 3, "method": "rkpm-gauss"},
    "geometry": {"kind": "box", "size": [1, 1, 1], "source": [3, 3, 3]},
    "material": [{**MUSCLE, "sigma_max": SIGMA, "fiber": [0, 0, 1]}],
    "boundary": [{"set": f"{x}{i}", f"u_{x}": 0} for x, i in ("x0", "y0", "z0", "z1")],
    "probe": [{"name": "pull", "quantity": "force_z", "set": "z1"}],
}
rows = list(csv.reader(line for line in DATA.open() if not line.startswith("#")))[1:]
length, force = np.linspace(0.56, 1.35, 21), np.zeros((2, 21))
with Scene.from_tables(BLOCK) as scene:
    for activation, k in np.ndindex(force.shape):
        scene.update({"boundary.z1.u_z": length[k] - 1, "load.activation": activation})
        last = scene.solve(error=False)
        force[activation, k] = scene.probes(last.x[-1:], last.load[-1:])[0, 0, 0] / SIGMA
for name, curve in (("active", force[1] - force[0]), ("passive", force[0])):
    x, y = np.array([row[1:] for row in rows if row[0] == name], float).T / [[OPTIMUM], [1]]
    error = np.interp(x, length, curve) - y
    print(f"{name}: rms error {np.sqrt(np.mean(error**2)):.3f}, largest {abs(error).max():.2f}")
    (line,) = plt.plot(length, curve, label=f"{name}, model")
    plt.plot(x, y, "o", color=line.get_color(), label=f"{name}, measured")
plt.plot(length, force[1], "k:", label="both together, model")
plt.xlabel("length of a sarcomere over its optimum")
plt.ylabel("force over the largest active force")
plt.ylim(-0.4, 1.8)
plt.legend(loc="upper left", ncol=2)
plt.savefig(sys.argv[1], dpi=100)
