"""Convergence of linear problems, Basava (2015), section 5.2, with basis orders 2, 3 and 4.

Rates are slopes of a straight line through logarithms of error and source spacing. Order 2 is run
with the published sizes, support and weights, which have twice as many collocation points as
source points along an edge. Orders 3 and 4 are run with these and with four times as many: the sum
over collocation points stands for an integral, whose error otherwise limits the L2 rates. Problems
with tractions are run with the published weight 1 of the traction rows and with 10: a sum over the
few boundary points counts less than the same integral would.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.console import ProgressCallback
from myork.stations.solve import run_deck

__all__ = ["run"]

_INPUTS = Path(__file__).parents[2] / "inputs"

_ELASTICITY = """\
title = "Plane strain with a smooth solution"
units = { force = "N", length = "m" }
scene = { dimension = 2 }
geometry = { kind = "box", size = [1, 1], source = [10, 10], collocation = [20, 20] }
linear = { problem = "elasticity", solution = "sine", E = 1, nu = 0.25, essential = ["x0", "y0"] }
"""

Sizes = tuple[tuple[int, ...], ...]


class _Study(NamedTuple):
    """A problem on several grids.

    Attributes
    ----------
    problem : str
        Name in tables and curves.
    deck : str
        Name of an installed deck, or the text of one.
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
    deck: str
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


def _studies(quick: bool) -> list[_Study]:
    """All studies, or those that take a second or two."""
    line = _Study("Poisson 1-D", "poisson_1d", _LINE, _denser(_LINE, 2), published=(3.07, 2.49))
    square = _Study(
        "Poisson 2-D", "poisson_2d", _SQUARE, _denser(_SQUARE, 2), published=(3.03, 2.43)
    )
    # 21 collocation points for 11 source points, as published
    cube = _Study(
        "Poisson 3-D", "poisson_3d", _CUBE, tuple((2 * n - 1,) * 3 for (n, _, _) in _CUBE)
    )
    beam = _Study("cantilever", "cantilever", _BEAM, _BEAM_COLLOCATION)
    plane = _Study("plane strain", _ELASTICITY, _SQUARE, _denser(_SQUARE, 2))
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
    """Solve all studies and fit their rates.

    Parameters
    ----------
    out : Path
        Folder of the benchmark; this one leaves no files there.
    progress : callable
        Called with a line a study.
    quick : bool
        Fewer orders and grids.

    Returns
    -------
    dict
        `name`, `title`, `about`, `cases` (one mapping a solve), `rates` (one a study), `tables`
        and `plots`.
    """
    cases: list[dict[str, Any]] = []
    rates: list[dict[str, Any]] = []
    studies = _studies(quick)
    for number, study in enumerate(studies):
        label = _label(study)
        progress(f"study {number + 1}/{len(studies)}  {label}")
        own = [_case(study, source, points) for source, points in _grids(study)]
        cases += own
        rates.append({"study": label, **_rates(study, own)})
    return {
        "name": "linear",
        "title": "Convergence of linear problems",
        "about": __doc__,
        "cases": cases,
        "rates": rates,
        "tables": [_table(rates)],
        "plots": [_plot(cases, norm) for norm in ("L2", "H1")],
    }


def _label(study: _Study) -> str:
    label = (
        f"{study.problem}, order {study.order}, support {study.support:g}h, "
        f"{study.density:g} collocation points a source point"
    )
    return label if study.traction == 1.0 else f"{label}, traction weight {study.traction:g}"


def _grids(study: _Study) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    return list(zip(study.source, study.collocation, strict=True))


def _case(study: _Study, source: Sequence[int], points: Sequence[int]) -> dict[str, Any]:
    """Errors of one grid."""
    with tempfile.TemporaryDirectory(prefix="myork-bench-") as folder:
        deck = _INPUTS / f"{study.deck}.toml"
        if "\n" in study.deck:
            deck = Path(folder) / "deck.toml"
            deck.write_text(study.deck, encoding="utf-8")
        overrides = (
            f"geometry.source={list(source)}",
            f"geometry.collocation={list(points)}",
            f"approximation.order={study.order}",
            f"approximation.support={study.support}",
            f"solver.weight_traction={study.traction}",
        )
        summary = run_deck(deck, Path(folder), overrides=overrides, threads=1, verbosity=-1)
    size = summary["deck"]["geometry"]["size"][0]
    return {
        "study": _label(study),
        "problem": study.problem,
        "order": study.order,
        "source": list(source),
        "collocation": list(points),
        "h": size / (source[0] - 1),
        "errors": summary["errors"],
        "dofs": summary["dofs"],
        "rows": summary["rows"],
        "solver": summary["solver"],
        "timings_s": summary["timings_s"],
    }


def _rates(study: _Study, cases: Sequence[dict[str, Any]]) -> dict[str, Any]:
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


def _table(rates: Sequence[dict[str, Any]]) -> dict[str, Any]:
    head = ["problem", "order", "support [h]", "collocation a source point", "traction weight"]
    head += ["L2 rate", "theory", "published", "H1 rate", "theory", "published"]
    head += ["relative L2 error, finest", "relative H1 error, finest"]
    rows = []
    for rate in rates:
        row: list[Any] = [rate["problem"], rate["order"], rate["support"], rate["density"]]
        row.append(rate["weight_traction"])
        for norm in ("L2", "H1"):
            slope = "reproduced" if rate["exact"] else round(rate[norm], 2)
            row += [slope, rate["theory"][norm], rate["published"].get(norm)]
        rows.append([*row, rate["finest"]["relative_L2"], rate["finest"]["relative_H1"]])
    return {
        "caption": "Fitted convergence rates; theory is (5.18). A cubic solution is reproduced to "
        "rounding by orders from 3 on.",
        "head": head,
        "rows": rows,
    }


def _plot(cases: Sequence[dict[str, Any]], norm: str) -> dict[str, Any]:
    """Error over spacing, a curve a study."""
    labels = list(dict.fromkeys(case["study"] for case in cases))
    series = []
    for label in labels:
        own = [case for case in cases if case["study"] == label]
        errors = [case["errors"][f"relative_{norm}"] for case in own]
        if errors[-1] < _ROUNDING and own[0]["problem"] == "cantilever":
            continue
        series.append({"name": label, "x": [case["h"] for case in own], "y": errors})
    return {
        "title": f"Relative {norm} error",
        "x": "source spacing [m]",
        "y": f"relative {norm} error [-]",
        "scale": "log-log",
        "series": series,
    }
