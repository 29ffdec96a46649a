"""A pulse that one end sends along a string and the other one, fixed, reflects: a linear motion."""

import sys
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

from myork import Results, run_deck

STRING = {
    "units": {"force": "N", "length": "m"},
    "scene": {"dimension": 1, "method": "rkpm-gauss"},
    "geometry": {"kind": "box", "size": [16], "source": [129]},
    "linear": {"problem": "elasticity", "E": 1},
    "dynamics": {"density": 1, "time_step": 0.05, "end_time": 26, "every": 4},
    "boundary": [{"set": "x0", "u_x": "exp(-(t - 4)^2)"}, {"set": "x1", "u_x": 0}],
    "probe": [{"name": "middle", "quantity": "u_x", "point": [8]}],
}  # fmt: skip

with TemporaryDirectory() as folder:
    run_deck(STRING, folder)
    with Results(folder) as results:
        time, u = results.loads, [results.field("u", k) for k in range(len(results.loads))]
        x = results.points[:, 0]
        print(results.summary["verdict"]["state"])
print(f"crest {np.max(u):.3f} at first, {np.min(u[-1]):.3f} m after its reflection")
plt.pcolormesh(x, time, np.array(u), cmap="RdBu_r", vmin=-1, vmax=1, shading="nearest")
plt.colorbar(label="displacement [m]")
plt.xlabel("x [m]")
plt.ylabel("time [s]")
plt.savefig(sys.argv[1], dpi=100)
