"""Results of a scene: converged states of a solve, and fields of one of them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from myork.types import F64, I64

#: In the order of the core
VERDICTS = ("", "accepted", "doubtful", "refused")


class States(NamedTuple):
    """Converged states of a solve."""

    x: F64  #: Unknowns: coefficients, or amplitudes of the modes, shape `(nstep, n)`
    load: F64  #: Fraction of the full load, shape `(nstep,)`
    iterations: I64  #: Iterations of each step, shape `(nstep,)`
    #: Smallest and largest volume ratio, shape `(nstep,)`
    min_j: F64
    max_j: F64
    solve_s: float  #: Wall time of the linear solutions [s]
    checks_s: float  #: Wall time of the checks that follow `backward_error` [s]
    backward_error: float  #: Largest backward error of a least squares solution
    #: Smallest eigenvalue of the acoustic tensor relative to the shear modulus at rest, shape
    #: `(nstep,)` [-]; where it is not positive the state is no longer unique. Not a number in
    #: linear problems and reduced models, where the entries below are zero or empty.
    min_acoustic: F64
    min_acoustic_point: F64  #: Where it was found, shape `(nstep, dimension)` [length]
    #: Sum of the forces on all boundary sets in the last state, relative to the largest of them [-]
    force_imbalance: float
    #: Work of the stress less work of the forces, both in the displacement of the last state,
    #: relative [-]. Not a number where they are not compared: weak forms, which balance them by
    #: construction, linear problems, and loads given by `set_fields`.
    work_mismatch: float
    #: Error norms of a linear problem with a known solution, by the names of `summary.json`: `L2`,
    #: `H1`, `relative_L2`, `relative_H1`
    errors: dict[str, float]
    warnings: list[str]  #: What deserves attention, the same list as in `summary.json`
    #: "accepted", "doubtful" or "refused"; empty for reduced models, which are not judged
    verdict: str
    #: Whether the equilibrium is unstable: it is one of several, and which one is found is chance
    unstable: bool
    reasons: list[str]  #: Reasons for doubt in the answer, and checks that were not made
    #: Estimated absolute error of each value of `Scene.probes`, shape `(nstep, nprobe, 3)`; not a
    #: number where there is no estimate
    probe_errors: F64

    def __repr__(self) -> str:
        lines = [
            f"{self.verdict or 'not judged'}: {_count(len(self.load), 'state')} to load "
            f"{self.load[-1]:g}, {_count(int(self.iterations.sum()), 'iteration')}, "
            f"J {self.min_j.min():.3g} to {self.max_j.max():.3g}",
            *self.reasons,
        ]
        return "States(" + "\n  ".join(lines) + ")"


class Fields(NamedTuple):
    """Fields at the collocation points."""

    u: F64  #: Displacement, shape `(npoint, 3)` [length]
    f: F64  #: Deformation gradient `F[point, i, A]`, shape `(npoint, 3, 3)`
    cauchy: F64  #: Cauchy stress xx, yy, zz, xy, yz, xz, shape `(npoint, 6)` [stress]
    #: These and all other fields by their names in result files, shape `(npoint, components)`: `F`
    #: row by row; `cauchy` as above, while `Results.field` returns it as tensors
    named: dict[str, F64]


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("s" if number != 1 else "")


def states_of(found: Mapping[str, Any]) -> States:
    """States from the core's answer to "states"."""
    info, seconds, worst, norms = (found[k] for k in ("info", "seconds", "worst", "norms"))
    point = info[5].astype(np.int64)
    seen = point > 0
    errors = dict(zip(("L2", "H1"), norms[:2].tolist(), strict=True))
    sizes = np.maximum(norms[2:], np.finfo(float).tiny).tolist()
    errors |= {
        f"relative_{k}": errors[k] / size for k, size in zip(("L2", "H1"), sizes, strict=True)
    }
    return States(
        x=found["x"].T,
        load=info[0],
        iterations=info[1].astype(np.int64),
        min_j=info[2],
        max_j=info[3],
        solve_s=float(seconds[1]),
        checks_s=float(seconds[2]),
        backward_error=float(worst[0]),
        min_acoustic=np.where(seen, info[4], np.nan),
        min_acoustic_point=np.where(seen[:, None], found["place"].T[point - 1], np.nan),
        force_imbalance=float(worst[1]),
        work_mismatch=float(worst[2]),
        errors=errors if norms[0] >= 0 else {},
        warnings=found["warnings"].splitlines(),
        verdict=VERDICTS[found["verdict"]],
        unstable=bool(found["unstable"]),
        reasons=found["reasons"].splitlines(),
        probe_errors=found["bars"].T,
    )
