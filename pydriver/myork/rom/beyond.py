"""States beyond the largest active stress of a training, for its modes alone."""

from itertools import product

import numpy as np

from myork.core.scene import Scene
from myork.rom.modes import LARGE, make_draft
from myork.rom.parameters import spread_points
from myork.rom.setting import Setting, Snapshots
from myork.types import F64

#: How far modes are to hold: this times the largest sigma_max of the range
REACH = 1.75
#: States that fill what is beyond, and those of the largest active stress at most
_SPREAD, _MOST_FACE = 16, 9
#: Values of each load there, and loads of which all values are combined at most
_ENDS, _MOST_COMBINED = 5, 4
#: Modes of the model that finds them; large bodies have fewer, since its volume takes their cube
_MODES, _MODES_OF_LARGE = 80, 60


def values_beyond(setting: Setting, seed: int) -> F64:
    """Values of parameters with sigma_max beyond its range, shape `(n, p)`; none if it is given."""
    kinds = setting.parameters
    if not any(p.kind == "sigma_max" for p in kinds):
        return np.zeros((0, len(kinds)))
    beyond = [
        p._replace(low=p.high, high=REACH * p.high) if p.kind == "sigma_max" else p for p in kinds
    ]
    most = [p._replace(low=p.high) if p.kind in ("sigma_max", "activation") else p for p in beyond]
    if sum(p.low < p.high for p in most) > _MOST_COMBINED:
        face = spread_points(most, _MOST_FACE, seed + 1)
    else:
        ends = [np.unique(np.linspace(p.low, p.high, _ENDS)) for p in most]
        face = np.array(list(product(*ends)))
        if len(face) > _MOST_FACE:
            face = np.random.default_rng(seed).permutation(face)[:_MOST_FACE]
    return np.vstack([face, spread_points(beyond, _SPREAD, seed)])


def states_beyond(
    scene: Scene, setting: Setting, snapshots: Snapshots, lifts: F64, seed: int
) -> F64:
    """States at these values, shape `(n, dofs)`.

    A constant of the muscle that nobody measures is asked for outside of the range sooner than a
    load is. The snapshots hold such states three times as well as the modes that are kept of them,
    which states of the range have chosen: no full solve is needed, but a model with nearly all
    modes, whose states there have a say in the choice.
    """
    values = values_beyond(setting, seed)
    if len(values) == 0:
        return np.zeros((0, scene.dofs))
    most = _MODES_OF_LARGE if len(setting.parts.weight) > LARGE else _MODES
    wide = make_draft(scene, setting, snapshots, lifts, 0.0, most=most, more=0)
    answer = wide.solve(setting, values)
    return np.asarray(answer.amplitudes[answer.converged] @ wide.basis.modes.T)
