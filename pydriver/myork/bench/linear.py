"""Rates of convergence of linear problems, Basava (2015), section 5.2.

A rate is the slope of a straight line through logarithms of error and source spacing. Orders 3 and
4 are run with twice and with four times as many collocation points as source points along an edge:
the sum over collocation points stands for an integral, whose error otherwise limits the L2 rates.
Problems with tractions are run with the published weight 1 of the traction rows and with 10: a sum
over the few boundary points counts less than the same integral would.
"""

from typing import Any, NamedTuple

import numpy as np

from myork.bench.runs import Deck, lattice, read_deck, solve_case
from myork.errors import ConvergenceError

#: A displacement of sines in both directions, and its stress and body force with E = 1, nu = 1/4
_U = ("sin(pi*x)*sin(pi*y)", "sin(pi*(x + 1/4))*sin(pi*(y + 1/4))")
_XX = "pi*(1.2*cos(pi*x)*sin(pi*y) + 0.4*sin(pi*(x + 1/4))*cos(pi*(y + 1/4)))"
_YY = "pi*(0.4*cos(pi*x)*sin(pi*y) + 1.2*sin(pi*(x + 1/4))*cos(pi*(y + 1/4)))"
_XY = "pi*(0.4*sin(pi*x)*cos(pi*y) + 0.4*cos(pi*(x + 1/4))*sin(pi*(y + 1/4)))"
_ELASTICITY = {
    "title": "Plane strain with a smooth solution",
    "units": {"force": "N", "length": "m"},
    "scene": {"dimension": 2, "method": "rkcm"},
    "geometry": {"kind": "box", "size": [1, 1], "source": [10, 10], "collocation": [20, 20]},
    "linear": {
        "problem": "elasticity",
        "E": 1,
        "nu": 0.25,
        "exact": list(_U),
        "source": [
            f"pi^2*(1.6*{_U[0]} - 0.8*cos(pi*(x + 1/4))*cos(pi*(y + 1/4)))",
            f"pi^2*(1.6*{_U[1]} - 0.8*cos(pi*x)*cos(pi*y))",
        ],
    },
    "boundary": [
        {"set": "x0", "u_x": _U[0], "u_y": _U[1]},
        {"set": "y0", "u_x": _U[0], "u_y": _U[1]},
        {"set": "x1", "traction": [_XX, _XY]},
        {"set": "y1", "traction": [_XY, _YY]},
    ],
}

Sizes = tuple[tuple[int, ...], ...]


class Study(NamedTuple):
    """A problem on several grids."""

    #: Name in tables and curves; installed deck, or `plane_strain`
    problem: str
    deck: str
    #: Points along each edge, coarsest grid first
    source: Sizes
    collocation: Sizes
    order: int = 2  #: Order of the basis; the support is one spacing more
    support: float = 3.0  #: Half width of the support in spacings
    traction: float = 1.0  #: Weight of the traction rows
    method: str = "rkcm"  #: Form, as of `scene.method`

    @property
    def label(self) -> str:
        """What distinguishes it from other studies."""
        density = round(self.collocation[-1][0] / self.source[-1][0], 1)
        label = f"{self.problem}, order {self.order}, support {self.support:g}h, n = {density:g}"
        return label if self.traction == 1.0 else f"{label}, traction weight {self.traction:g}"


def _study(
    problem: str, deck: str, source: Sizes, factor: int = 2, order: int = 2, **rest: Any
) -> Study:
    """A study with so many collocation points a source point, and a support of order + 1."""
    points = tuple(tuple(factor * n for n in size) for size in source)
    return Study(problem, deck, source, points, order, **{"support": order + 1.0, **rest})


_LINE = tuple((n,) for n in (10, 15, 20, 25, 30))
_SQUARE = tuple((n, n) for n in (10, 15, 20, 25, 30))
_CUBE = tuple((n, n, n) for n in (6, 8, 11))
_BEAM = ((17, 5), (25, 7), (33, 9), (41, 11), (49, 13), (57, 15))
_BEAM_COLLOCATION = ((35, 11), (51, 15), (67, 19), (83, 23), (99, 27), (115, 31))
_PLANE = ("plane strain", "plane_strain", _SQUARE)

#: The published problems with their grids; the cube has 21 points for 11 source points
PUBLISHED_STUDIES = {
    study.problem: study
    for study in (
        _study("Poisson 1-D", "poisson_1d", _LINE),
        _study("Poisson 2-D", "poisson_2d", _SQUARE),
        Study("Poisson 3-D", "poisson_3d", _CUBE, tuple((2 * n - 1,) * 3 for (n, _, _) in _CUBE)),
        Study("cantilever", "cantilever", _BEAM, _BEAM_COLLOCATION),
    )
}
_SOLID, _BENT = PUBLISHED_STUDIES["Poisson 3-D"], PUBLISHED_STUDIES["cantilever"]
#: Other supports, weights of tractions and orders; the cubic cantilever is reproduced from order 3
HIGHER_STUDIES = (
    _BENT._replace(support=4.0),
    _BENT._replace(traction=10.0),
    _study(*_PLANE),
    _study(*_PLANE, traction=10.0),
    *(
        _study(problem, deck, source, factor, order)
        for order in (3, 4)
        for problem, deck, source in (
            ("Poisson 1-D", "poisson_1d", _LINE),
            ("Poisson 2-D", "poisson_2d", _SQUARE),
        )
        for factor in (2, 4)
    ),
    *(_study(*_PLANE, 4, order, traction=10.0) for order in (3, 4)),
    _BENT._replace(order=3, support=4.0),
    _SOLID._replace(order=3, support=4.0),
)


def study_rates(study: Study) -> dict[str, Any]:
    """Fitted rates of a study, `L2` and `H1`, its `cases`, and the relative errors of the last."""
    deck: Deck = _ELASTICITY if study.deck == "plane_strain" else study.deck
    length = read_deck(deck)["geometry"]["size"][0]
    cases = []
    for source, points in zip(study.source, study.collocation, strict=True):
        words = (
            *lattice(source, points),
            f"approximation.order={study.order}",
            f"approximation.support={study.support}",
            f"solver.weight_traction={study.traction}",
            f"scene.method={study.method}",
        )
        case = solve_case(deck, words)
        if "errors" not in case:
            raise ConvergenceError(f"{study.label}: {case['outcome']}: {case['message']}")
        cases.append({**case, "curve": study.label, "h": length / (source[0] - 1)})
    h = np.log([case["h"] for case in cases])
    rates = {
        norm: float(np.polyfit(h, np.log([case["errors"][norm] for case in cases]), 1)[0])
        for norm in ("L2", "H1")
    }
    return {**rates, "finest": cases[-1]["errors"], "cases": cases}
