"""A reduced model of a muscle: its force over activation and length, from sixteen full solves."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from myork import ReducedModel

DECK = Path(__file__).parents[1] / "inputs" / "muscle_block.toml"
SMALL = ["geometry.source=[3,3,5]", "scene.method=rkpm-scni"]
RANGES = {"load.activation": (0, 0.6), "boundary.z1.u_z": (-0.2, 0.3)}

model = ReducedModel.train(DECK, RANGES, full_solves=16, overrides=SMALL)
activation, u = np.meshgrid(np.linspace(0, 0.6, 40), np.linspace(-0.2, 0.3, 40))
states = model.batch(np.stack([activation.ravel(), u.ravel()], axis=1), indicator=True)
print(f"{states.converged.sum()} of {u.size} states, forces to {states.force.max():.1f} N")
print(f"largest estimated error {np.nanmax(states.indicator):.1e}")
plt.contourf(activation, 2 + u, states.force.reshape(u.shape), 20)
plt.colorbar(label="force [N]")
plt.xlabel("activation")
plt.ylabel("length of the muscle [cm]")
plt.savefig(sys.argv[1], dpi=100)
