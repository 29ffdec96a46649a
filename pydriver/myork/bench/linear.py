"""Convergence of linear problems, Basava (2015), section 5.2, with basis orders 2, 3 and 4.

Rates are slopes of a straight line through logarithms of error and source spacing. Order 2 is run
with the published sizes, support and weights, which have twice as many collocation points as
source points along an edge. Orders 3 and 4 are run with these and with four times as many: the sum
over collocation points stands for an integral, whose error otherwise limits the L2 rates. Problems
with tractions are run with the published weight 1 of the traction rows and with 10: a sum over the
few boundary points counts less than the same integral would.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.bench.runs import Deck, lattice, read_deck, solve_case
from myork.bench.tables import Columns, plot, table
from myork.console import ProgressCallback
from myork.errors import ConvergenceError

__all__ = ["PUBLISHED_STUDIES", "Study", "run", "study_rates"]

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
    """A problem on several grids.

    Attributes
    ----------
    problem : str
        Name in tables and curves.
    deck : Deck
        Name of an installed deck, or tables.
    source, collocation : Sizes
        Points along each edge, coarsest grid first.
    order : int
        Order of the basis.
    support : float
        Half width of the support in spacings.
    traction : float
        Weight of the traction rows.
    published : tuple of float
        Published L2 and H1 rates, empty where there are none.
    """

    problem: str
    deck: Deck
    source: Sizes
    collocation: Sizes
    order: int = 2
    support: float = 3.0
    traction: float = 1.0
    published: tuple[float, ...] = ()

    @property
    def density(self) -> float:
        """Collocation points per source point along an edge, on the finest grid."""
        return round(self.collocation[-1][0] / self.source[-1][0], 1)


_LINE = tuple((n,) for n in (10, 15, 20, 25, 30))
_SQUARE = tuple((n, n) for n in (10, 15, 20, 25, 30))
_CUBE = tuple((n, n, n) for n in (6, 8, 11))
_BEAM = ((17, 5), (25, 7), (33, 9), (41, 11), (49, 13), (57, 15))
_BEAM_COLLOCATION = ((35, 11), (51, 15), (67, 19), (83, 23), (99, 27), (115, 31))


def _denser(sizes: Sizes, factor: int) -> Sizes:
    return tuple(tuple(factor * n for n in size) for size in sizes)


#: The published problems with their grids, which have twice as many collocation points an edge;
#: the cube has 21 for 11 source points
PUBLISHED_STUDIES = {
    study.problem: study
    for study in (
        Study("Poisson 1-D", "poisson_1d", _LINE, _denser(_LINE, 2), published=(3.07, 2.49)),
        Study("Poisson 2-D", "poisson_2d", _SQUARE, _denser(_SQUARE, 2), published=(3.03, 2.43)),
        Study("Poisson 3-D", "poisson_3d", _CUBE, tuple((2 * n - 1,) * 3 for (n, _, _) in _CUBE)),
        Study("cantilever", "cantilever", _BEAM, _BEAM_COLLOCATION),
    )
}


def _studies(quick: bool) -> list[Study]:
    """All studies, or those that take a second or two."""
    line, square, cube, beam = PUBLISHED_STUDIES.values()
    plane = Study("plane strain", _ELASTICITY, _SQUARE, _denser(_SQUARE, 2))
    studies = [line, square, cube, beam, beam._replace(support=4.0)]
    studies += [beam._replace(traction=10.0), plane, plane._replace(traction=10.0)]
    for order in (3, 4):
        higher = [study._replace(order=order, support=order + 1.0) for study in (line, square)]
        higher += [study._replace(collocation=_denser(study.source, 4)) for study in higher]
        higher.append(
            plane._replace(
                order=order,
                support=order + 1.0,
                collocation=_denser(plane.source, 4),
                traction=10.0,
            )
        )
        studies += [study._replace(published=()) for study in higher]
    # the solution is a polynomial of degree 3: nothing is left but rounding
    studies.append(beam._replace(order=3, support=4.0))
    studies.append(cube._replace(order=3, support=4.0))
    if quick:
        slow = ("Poisson 3-D", "plane strain")
        studies = [
            study._replace(source=study.source[:4], collocation=study.collocation[:4])
            for study in studies
            if study.problem not in slow and (study.order == 2 or study.problem == "Poisson 1-D")
        ]
    return studies


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all studies and fit their rates; see `myork.bench` for the result."""
    cases: list[dict[str, Any]] = []
    rates: list[dict[str, Any]] = []
    studies = _studies(quick)
    for number, study in enumerate(studies):
        label = _label(study)
        progress(f"study {number + 1}/{len(studies)}  {label}")
        own, found = study_rates(study)
        cases += own
        rates.append({"study": label, **found})
    return {
        "name": "linear",
        "title": "Convergence of linear problems",
        "about": __doc__,
        "cases": cases,
        "rates": rates,
        "tables": [_table(rates)],
        "plots": [_plot(cases, norm) for norm in ("L2", "H1")],
    }


def study_rates(study: Study) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Cases of all grids of a study, and its fitted rates, `L2` and `H1`."""
    sizes = zip(study.source, study.collocation, strict=True)
    cases = [_case(study, *size) for size in sizes]
    return cases, _rates(study, cases)


def _label(study: Study) -> str:
    label = (
        f"{study.problem}, order {study.order}, support {study.support:g}h, "
        f"{study.density:g} collocation points a source point"
    )
    return label if study.traction == 1.0 else f"{label}, traction weight {study.traction:g}"


def _case(study: Study, source: Sequence[int], points: Sequence[int]) -> dict[str, Any]:
    """Errors of one grid."""
    overrides = (
        *lattice(source, points),
        f"approximation.order={study.order}",
        f"approximation.support={study.support}",
        f"solver.weight_traction={study.traction}",
    )
    case = solve_case(study.deck, overrides)
    if "errors" not in case:
        raise ConvergenceError(f"{_label(study)}: {case['outcome']}: {case['message']}")
    return {
        **case,
        "study": _label(study),
        "problem": study.problem,
        "order": study.order,
        "source": list(source),
        "collocation": list(points),
        "h": read_deck(study.deck)["geometry"]["size"][0] / (source[0] - 1),
    }


def _rates(study: Study, cases: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Fitted rates of a study beside theory (5.18) and the published ones."""
    h = np.log([case["h"] for case in cases])
    found = {
        norm: float(np.polyfit(h, np.log([case["errors"][norm] for case in cases]), 1)[0])
        for norm in ("L2", "H1")
    }
    return {
        "problem": study.problem,
        "order": study.order,
        "support": study.support,
        "density": study.density,
        "weight_traction": study.traction,
        **found,
        "theory": {"L2": study.order + 1, "H1": study.order},
        "published": dict(zip(("L2", "H1"), study.published, strict=False)),
        "finest": cases[-1]["errors"],
        "exact": cases[-1]["errors"]["relative_H1"] < _ROUNDING,
    }


#: A relative error below which a solution counts as reproduced
_ROUNDING = 1e-9


def _rate(norm: str) -> Callable[[Mapping[str, Any]], Any]:
    """Fitted rate in a norm."""
    return lambda rate: "reproduced" if rate["exact"] else round(rate[norm], 2)


_COLUMNS: Columns = (
    ("problem", "problem"),
    ("order", "order"),
    ("support [h]", "support"),
    ("collocation a source point", "density"),
    ("traction weight", "weight_traction"),
    ("L2 rate", _rate("L2")),
    ("theory", "theory.L2"),
    ("published", "published.L2"),
    ("H1 rate", _rate("H1")),
    ("theory", "theory.H1"),
    ("published", "published.H1"),
    ("relative L2 error, finest", "finest.relative_L2"),
    ("relative H1 error, finest", "finest.relative_H1"),
)


def _table(rates: Sequence[dict[str, Any]]) -> dict[str, Any]:
    return table(
        "Fitted convergence rates; theory is (5.18). A cubic solution is reproduced to "
        "rounding by orders from 3 on.",
        _COLUMNS,
        rates,
    )


def _plot(cases: Sequence[dict[str, Any]], norm: str) -> dict[str, Any]:
    """Error over spacing, a curve a study, but for a cantilever that is reproduced."""
    finest = {case["study"]: case["errors"][f"relative_{norm}"] for case in cases}
    shown = [
        case
        for case in cases
        if case["problem"] != "cantilever" or finest[case["study"]] >= _ROUNDING
    ]
    axes = ("source spacing [m]", f"relative {norm} error [-]")
    return plot(f"Relative {norm} error", axes, shown, "h", f"errors.relative_{norm}", "study")
