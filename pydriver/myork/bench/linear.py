"""Rates of convergence of linear problems, Basava (2015), section 5.2.

A rate is the slope of a straight line fitted to the logarithms of error over source spacing.
"""

from typing import Any, NamedTuple

import numpy as np

from myork.bench.runs import lattice, read_deck, solved

Sizes = tuple[tuple[int, ...], ...]


class Study(NamedTuple):
    """A problem on several grids."""

    problem: str  #: Name in tables and curves
    deck: str  #: Installed deck, or a path without suffix
    #: Points along each edge, coarsest grid first
    source: Sizes
    collocation: Sizes
    order: int = 2  #: Order of the basis; the support is one spacing more
    support: float = 3.0  #: Half width of the support in spacings
    traction: float = 1.0  #: Weight of the traction rows
    method: str = "rkcm"  #: Form, as in `scene.method`

    @property
    def label(self) -> str:
        """Settings that distinguish it from other studies."""
        density = round(self.collocation[-1][0] / self.source[-1][0], 1)
        label = f"{self.problem}, order {self.order}, support {self.support:g}h, n = {density:g}"
        return label if self.traction == 1.0 else f"{label}, traction weight {self.traction:g}"


_LINE = tuple((n,) for n in (10, 15, 20, 25, 30))
_SQUARE = tuple((n, n) for n in (10, 15, 20, 25, 30))
_CUBE = tuple((n, n, n) for n in (6, 8, 11))
_BEAM = ((17, 5), (25, 7), (33, 9), (41, 11), (49, 13), (57, 15))
_BEAM_COLLOCATION = ((35, 11), (51, 15), (67, 19), (83, 23), (99, 27), (115, 31))

#: The published problems with their grids; the cube has 21 points for 11 source points
PUBLISHED_STUDIES = {
    study.problem: study
    for study in (
        Study("Poisson 1-D", "poisson_1d", _LINE, tuple((2 * n,) for (n,) in _LINE)),
        Study("Poisson 2-D", "poisson_2d", _SQUARE, tuple((2 * n,) * 2 for (n, _) in _SQUARE)),
        Study("Poisson 3-D", "poisson_3d", _CUBE, tuple((2 * n - 1,) * 3 for (n, _, _) in _CUBE)),
        Study("cantilever", "cantilever", _BEAM, _BEAM_COLLOCATION),
    )
}


def study_rates(study: Study) -> dict[str, Any]:
    """Fitted rates of a study, `L2` and `H1`, and its `cases`."""
    length = read_deck(study.deck)["geometry"]["size"][0]
    cases = []
    for source, points in zip(study.source, study.collocation, strict=True):
        words = (
            *lattice(source, points),
            f"approximation.order={study.order}",
            f"approximation.support={study.support}",
            f"solver.weight_traction={study.traction}",
            f"scene.method={study.method}",
        )
        case = solved(study.deck, words)
        cases.append({**case, "curve": study.label, "h": length / (source[0] - 1)})
    h = np.log([case["h"] for case in cases])
    rates = {
        norm: float(np.polyfit(h, np.log([case["errors"][norm] for case in cases]), 1)[0])
        for norm in ("L2", "H1")
    }
    return {**rates, "cases": cases}
