"""An energy of your own: rubber that stiffens when it is stretched, beside neo-Hookean rubber."""

import sys

import matplotlib.pyplot as plt
import numpy as np

from myork import Scene

LAWS = {
    "neo-hookean": {"model": "neo-hookean", "mu": 10},
    "own energy": {"model": "energy", "mu": 10, "energy": "mu/2*(exp(0.3*(I1 - 3)) - 1)/0.3"},
}
CUBE = {
    "scene": {"dimension": 3, "method": "rkpm-gauss"},
    "units": {"force": "N", "length": "cm"},
    "geometry": {"kind": "box", "size": [1, 1, 1], "source": [3, 3, 3]},
    "boundary": [{"set": f"{axis}0", f"u_{axis}": 0} for axis in "xyz"]
    + [{"set": "z1", "u_z": 1.0}],
    "load": {"steps": 10},
    "probe": [{"name": "pull", "quantity": "force_z", "set": "z1"}],
}

for name, law in LAWS.items():
    deck = {**CUBE, "material": [{"name": "rubber", "K": 1000, **law}]}
    with Scene.from_tables(deck) as scene:
        states = scene.solve(error=False)
        pull = [scene.probes(x[None], [load])[0, 0, 0]
                for x, load in zip(states.x, states.load, strict=True)]  # fmt: skip
    plt.plot(1 + np.array(states.load), pull, marker="o", label=name)
    print(f"{name}: {pull[-1]:.2f} N at twice the length")
plt.xlabel("stretch")
plt.ylabel("force [N]")
plt.legend()
plt.savefig(sys.argv[1], dpi=100)
