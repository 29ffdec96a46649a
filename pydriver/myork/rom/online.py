"""States of a reduced model: regression, Newton correction, fallback and error estimate."""

from typing import Any, NamedTuple

import numpy as np

from myork.core.online import Cells, Model, online_states, record
from myork.errors import InputError
from myork.rom.projection import Laws
from myork.types import F64, I64, Mask

#: Newton's method stops at a relative step of this size: the next one would be its square, and
#: is below 3e-7
TOLERANCE = 3e-4
MOST_STEPS = 20
#: Numbers of increments from the nearest known state that are tried where the regression fails
PARTS = (1, 2, 4, 8)
#: Relative change from the regression up to which a solution is the intended one; states count as
#: no smaller than this share of the largest known one
_NEAR, _LEAST = 0.3, 0.2


class Answer(NamedTuple):
    """States for many parameters."""

    amplitudes: F64  #: Amplitudes of the modes, shape `(n, r)`
    force: F64  #: Requested forces, shape `(n, nf)`
    iterations: I64  #: Newton iterations, fallbacks included, shape `(n,)`
    converged: Mask  #: Whether a state is a solution, shape `(n,)`
    min_j: F64  #: Smallest volume ratio of the evaluated cells, shape `(n,)`


class Regression:
    """Cubic radial basis functions of scaled parameters, fitted to the training states."""

    def __init__(self, points: F64, values: F64, scale: F64) -> None:
        from scipy.interpolate import RBFInterpolator

        n, p = points.shape
        self._scale = scale
        # lower the degree until the points determine the polynomial: rays lie in few planes
        degree = 2 if n > (p + 1) * (p + 2) else 1 if n > p + 1 else 0
        while True:
            try:
                kernel = "cubic" if degree else "linear"
                self._function = RBFInterpolator(
                    points / scale, values, kernel=kernel, degree=degree
                )
                break
            except np.linalg.LinAlgError:
                if degree == 0:
                    raise InputError("all training states are the same") from None
                degree -= 1

    def __call__(self, points: F64) -> F64:
        """Values at points, shape `(n, p)`."""
        return np.asarray(self._function(np.atleast_2d(points) / self._scale))


class Conditions(NamedTuple):
    """Requested conditions, one row per state."""

    #: By tissue; the last is the rotation angle of the fibers [rad], shape `(n, nt)`
    activation: F64
    sigma_max: F64
    turn: F64
    modulus: F64  #: Moduli that are parameters, less their values in the model, shape `(n, nm)`
    given: F64  #: Prescribed amplitudes, shape `(n, s - r)`

    def one(self, i: int) -> "Conditions":
        """The conditions of one state."""
        return Conditions(*(a[i : i + 1] for a in self))

    def columns(self) -> F64:
        """In the layout of the core: one column per state."""
        state = np.stack([self.activation.T, self.sigma_max.T, self.turn.T], axis=1)
        state = state.reshape(-1, len(self.given), order="F")
        return np.asfortranarray(np.concatenate([state, self.modulus.T, self.given.T]))


class Solver:
    """A reduced model with known states to start from.

    - `model`: cells evaluated in the Newton iteration
    - `whole`: cells from which forces are computed
    - `wanted`: amplitudes, from 0, whose forces are requested
    - `threads`: number of threads, 0 for all cores
    - `least`: size below which amplitudes count as zero
    """

    def __init__(
        self, model: Model, whole: Cells, wanted: I64, threads: int, least: float = 1e-300
    ) -> None:
        self.model = model
        self._record = record(model, model.cells)
        self._whole = self._record if whole is model.cells else record(model, whole)
        self.threads = threads
        self.least = least
        # the wrapper takes no empty arrays; a single 0 means no force
        self._wanted = np.asarray(wanted, np.int32) + 1 if len(wanted) else np.zeros(1, np.int32)
        self._count = len(wanted)

    def newton(
        self,
        conditions: Conditions,
        start: F64,
        known: Conditions | None = None,
        parts: int = 0,
        tolerance: float = TOLERANCE,
        most: int = MOST_STEPS,
        lift: F64 | None = None,
    ) -> tuple[Answer, F64]:
        """Newton iteration from amplitudes, or in increments from known states.

        `lift` gives the derivative of the modes by the amplitudes whose forces are requested, shape
        `(n, r, nf)`; without it forces are not stationary.

        - returns `answer`: the states
        - returns `change`: relative size of their last steps
        """
        n, r = len(start), self.model.r
        s = self.model.cells.h.shape[2]
        begin = np.zeros((s, n), order="F")
        begin[:r] = start.T
        if lift is None:
            lift = np.zeros((n, r, len(self._wanted)))
        known = known or conditions
        z, iterations, change, min_j, force = online_states(
            self._record, self._whole, conditions.columns(), begin, np.full(n, parts, np.int32),
            known.columns(), (self.least, tolerance), most, self.threads, self._wanted,
            np.asfortranarray(np.moveaxis(lift, 0, 2)),
        )  # fmt: skip
        answer = Answer(z[:r].T, force[: self._count].T, np.abs(iterations), iterations > 0, min_j)
        return answer, change

    def solve(
        self,
        conditions: Conditions,
        start: F64,
        known: Conditions,
        amplitudes: F64,
        nearest: I64,
        most: int = MOST_STEPS,
        lift: F64 | None = None,
    ) -> Answer:
        """States from a start; failed ones are followed from the nearest known states."""
        if most < MOST_STEPS:
            # exactly the requested number of corrections; whether they suffice is reported
            answer, change = self.newton(conditions, start, tolerance=0.0, most=most, lift=lift)
            return answer._replace(converged=answer.converged & (change < TOLERANCE))
        answer = self.newton(conditions, start, lift=lift)[0]
        # a diverging iteration may have found another solution: the path decides
        size = np.linalg.norm(answer.amplitudes, axis=1)
        least = _LEAST * np.linalg.norm(amplitudes, axis=1).max(initial=0.0)
        moved = np.linalg.norm(answer.amplitudes - start, axis=1)
        answer.converged[~(moved <= _NEAR * np.maximum(size, least))] = False
        for parts in PARTS:
            failed = np.flatnonzero(~answer.converged)
            if len(failed) == 0:
                break
            begin = Conditions(*(a[nearest[failed]] for a in known))
            wish = Conditions(*(a[failed] for a in conditions))
            again = self.newton(
                wish,
                amplitudes[nearest[failed]],
                begin,
                parts,
                lift=None if lift is None else lift[failed],
            )[0]
            for old, new in zip(answer, again, strict=True):
                if old is not answer.iterations:
                    old[failed] = new
            answer.iterations[failed] += again.iterations
        return answer


def conditions_of(
    values: F64, kinds: Any, laws: Laws, extra: int, share: F64 | None = None
) -> Conditions:
    """Conditions of states from the values of the parameters.

    - `values`: values, shape `(n, p)`
    - `laws`: materials of the deck
    - `extra`: number of amplitudes for forces, which are zero
    - `share`: fraction of the prescribed loads other than the parameters; 1 by default
    """
    n = len(values)
    activation = np.tile(laws.activation, (n, 1))
    sigma = np.tile(laws.sigma_max, (n, 1))
    turn = np.zeros_like(activation)
    modulus = np.zeros((n, len(laws.modulus)))
    given = np.zeros((n, 1 + sum(p.columns for p in kinds) + extra))
    given[:, 0] = 1.0 if share is None else share
    if share is not None:
        activation *= share[:, None]
    load = number = 0
    for j, parameter in enumerate(kinds):
        tissues = list(parameter.tissues)
        column = parameter.end * values[:, j, None]
        if parameter.kind == "load":
            given[:, load + 1] = column[:, 0]
        elif parameter.kind == "rotation":
            angle = np.radians(column[:, 0])
            given[:, load + 1], given[:, load + 2] = np.sin(angle), 1.0 - np.cos(angle)
        elif parameter.kind == "activation":
            activation[:, tissues] = column
        elif parameter.kind == "sigma_max":
            sigma[:, tissues] = column
        elif parameter.kind == "fiber_angle":
            turn[:, tissues] = np.radians(column - laws.angle[tissues])
        else:
            modulus[:, number] = column[:, 0] - laws.modulus[number]
            number += 1
        load += parameter.columns
    return Conditions(activation, sigma, turn, modulus, given)
