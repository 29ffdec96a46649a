"""`linear`, `nonlinear` and `rom`: tables of the dissertation, and what it lacks.

Orders above 2, forms and iterations beside exact solutions, and reduced models of the Galerkin
form. They are tables of runs and rows as those of `myork.bench.dissertation`, and run by the same
code; their reference is theory or an exact solution.

Orders 3 and 4 are run with twice and with four times as many collocation points as source points
along an edge: the sum over collocation points stands for an integral, whose error otherwise limits
the L2 rates. Problems with tractions are run with the published weight 1 of the traction rows and
with 10: a sum over the few boundary points counts less than the same integral would.
"""

from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.page import plot, table
from benchmarks.runs import METHODS, PUBLISHED_BLOCK
from benchmarks.truths import exact
from myork.bench.dissertation import TABLES, Row, Run, Table
from myork.bench.linear import PUBLISHED_STUDIES, Sizes, Study
from myork.bench.reproduce import compute, rows_of
from myork.bench.runs import lattice, read_deck
from myork.console import ProgressCallback


def study_of(
    problem: str, deck: str, source: Sizes, factor: int = 2, order: int = 2, **rest: Any
) -> Study:
    """A study with a ratio of collocation to source points, and a support of order + 1."""
    points = tuple(tuple(factor * n for n in size) for size in source)
    return Study(problem, deck, source, points, order, **{"support": order + 1.0, **rest})


#: Limit in seconds of a table's time when small cases are wanted
_QUICK = 3.0
_PLANE = (
    "plane strain",
    str(Path(__file__).with_name("plane_strain")),
    PUBLISHED_STUDIES["Poisson 2-D"].source,
)
_SOLID, _BENT = PUBLISHED_STUDIES["Poisson 3-D"], PUBLISHED_STUDIES["cantilever"]
#: Other supports, traction weights and orders; the cubic cantilever is reproduced from order 3 on
_HIGHER_STUDIES = (
    _BENT._replace(support=4.0),
    _BENT._replace(traction=10.0),
    study_of(*_PLANE),
    study_of(*_PLANE, traction=10.0),
    *(
        study_of(study.problem, study.deck, study.source, factor, order)
        for order in (3, 4)
        for study in (PUBLISHED_STUDIES[f"Poisson {n}-D"] for n in (1, 2))
        for factor in (2, 4)
    ),
    *(study_of(*_PLANE, 4, order, traction=10.0) for order in (3, 4)),
    _BENT._replace(order=3, support=4.0),
    _SOLID._replace(order=3, support=4.0),
)
#: Function that computes a value of a problem from its deck
_Solution = Callable[[dict[str, Any]], float]


def _rates(study: Study) -> Table:
    """Rates of a problem compared with theory (5.18)."""
    rows = tuple(
        Row(f"rate in {norm}, theory", float(rate), ("rates", norm))
        for norm, rate in (("L2", study.order + 1), ("H1", study.order))
    )
    seconds = {"Poisson 1-D": 1, "Poisson 2-D": 3, "cantilever": 3}
    run = Run("rates", study.deck, (), study)
    return Table(study.label, "linear problem", {"rates": run}, rows, seconds.get(study.problem, 9))


def _beside(name: str, deck: str, key: str, choices: dict[str, tuple[str, ...]]) -> Table:
    """A quantity of a deck for several settings."""
    runs = {choice: Run("solve", deck, words) for choice, words in choices.items()}
    rows = tuple(Row(choice, None, (choice, key)) for choice in runs)
    return Table(name, key, runs, rows, 2.0)


_LINEAR_FORMS = ("rkpm-gauss", "rkcm")
_LOADS = (
    _beside(
        "poisson_own, order 2",
        "poisson_own",
        "errors.relative_L2",
        {
            f"{form}, {n} x {n}": (
                f"scene.method={form}",
                "approximation.order=2",
                *lattice((n, n)),
            )
            for form, n in product(_LINEAR_FORMS, (9, 17, 33))
        },
    ),
    _beside(
        "wave_1d at time 6",
        "wave_1d",
        "errors.relative_L2",
        {
            f"{form}, time step {step}": (f"scene.method={form}", f"dynamics.time_step={step}")
            for form, step in product(_LINEAR_FORMS, (0.2, 0.1, 0.05))
        },
    ),
)


def _homogeneous(function: Callable[[exact.Polynomial, float], float], amount: float) -> _Solution:
    return lambda deck: function(exact.Polynomial.from_deck(deck["material"][0]), amount)


def _fixed_fibers(deck: dict[str, Any]) -> float:
    """Axial stress of a muscle block far from its fixed ends, where fibers keep their length."""
    return exact.along_fibers(deck["material"][0], deck["load"]["activation"])


def _known(
    name: str,
    deck: str,
    probe: str,
    solution: _Solution,
    words: tuple[str, ...] = (),
    methods: Sequence[str] = METHODS,
    cost: float = 9.0,
) -> Table:
    """A problem in both forms, compared with the exact solution for its bulk modulus."""
    runs = {form: Run("solve", deck, (*words, f"scene.method={form}")) for form in methods}
    # the last form admits any bulk modulus
    wanted = solution(read_deck(deck, runs[methods[-1]].overrides))
    rows = tuple(Row(f"{form} [N/cm²]", wanted, (form, f"probes.{probe}")) for form in methods)
    return Table(name, "stress at full load", runs, rows, cost)


_BLOCK = (*lattice((5, 5, 9)), "load.activation=0.5", "load.steps=5", *PUBLISHED_BLOCK)


def _nonlinear() -> tuple[Table, ...]:
    """Problems with exact solutions, which are evaluated here."""
    return (
        _known(
            "shear, gamma = 5, of the infinitely wide block",
            "shear_3d",
            "shear_stress",
            _homogeneous(exact.simple_shear, 5.0),
            cost=2,
        ),
        *(
            _known(name, deck, "stress", _homogeneous(function, amount), cost=cost)
            for name, deck, function, amount, cost in (
                ("tension to 6", "uniaxial_tension", exact.uniaxial, 6.0, 2),
                ("compression to 0.1", "uniaxial_compression", exact.uniaxial, 0.1, 3),
                ("equibiaxial to 2", "equibiaxial", exact.equibiaxial, 2.0, 9),
                ("dilation to 6", "dilation", exact.dilation, 6.0, 9),
            )
        ),
        *(
            _known(
                f"tube, K = {bulk}", "tube", "radial_stress", exact.inner_stress,
                (f"material.K={bulk}",), METHODS[1:] if bulk == "inf" else METHODS,
            )
            for bulk in ("1e3", "1e7", "1e10", "inf")
        ),
        *(
            _known(
                f"tube of order 1, K = {bulk}", "tube", "radial_stress", exact.inner_stress,
                (f"material.K={bulk}", "load.steps=12", "approximation.order=1",
                 "approximation.support=2", "approximation.kernel=cubic", "galerkin.gauss=2"),
                ("rkpm-gauss", "rkpm-scni"),
            )
            for bulk in ("1e3", "1e5", "1e8", "inf")
        ),
        _known("muscle block, on kinks", "muscle_block", "stress_zz", _fixed_fibers, _BLOCK),
        _known(
            "muscle block, smooth curves", "muscle_block", "stress_zz", _fixed_fibers,
            (*_BLOCK, 'material.curve="smooth"'),
        ),
    )  # fmt: skip


def _galerkin(name: str, deck: str, words: tuple[str, ...], modes: tuple[int, ...]) -> Table:
    """A load path of chapter 6 in the Galerkin form, with an affordable number of points."""
    rows = [Row("full model [min]", None, ("path", "full.cpu_min"))]
    for r in modes:
        rows += [
            Row(f"r = {r}, e1", None, ("path", f"{r}.e1")),
            Row(f"r = {r}, e1 of the modes alone", None, ("path", f"{r}.best_e1")),
            Row(f"r = {r} [min]", None, ("path", f"{r}.cpu_min")),
        ]
    run = Run("path", deck, words, modes)
    return Table(name, "Galerkin form", {"path": run}, tuple(rows), 60.0)


#: Tables of each benchmark
STUDIES: dict[str, Callable[[], tuple[Table, ...]]] = {
    "linear": lambda: (
        *(_rates(study) for study in (*PUBLISHED_STUDIES.values(), *_HIGHER_STUDIES)),
        *_LOADS,
    ),
    "nonlinear": _nonlinear,
    "rom": lambda: (
        TABLES["6.1"],
        TABLES["6.2"],
        _galerkin("tube", "tube", ("scene.method=rkpm-gauss", *lattice((9, 51))), (2, 5, 10)),
        _galerkin(
            "muscle block", "muscle_block", (*lattice((5, 5, 9)), "load.steps=10"), (1, 2, 5, 10)
        ),
        _galerkin("medial gastrocnemius", "mg_muscle", (), (2, 5, 10)),
    ),
}
_TITLES = {
    "linear": "Convergence of linear problems",
    "nonlinear": "Nonlinear problems beside exact solutions",
    "rom": "Full and reduced models of chapter 6",
}


def run(name: str, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Compute the tables of a benchmark; see `benchmarks.bench` for the result."""
    tables = [entry for entry in STUDIES[name]() if not quick or entry.cost_s <= _QUICK]
    records: dict[Run, Any] = {}
    cases: list[dict[str, Any]] = []
    rows: list[dict[str, Any]] = []
    for number, entry in enumerate(tables, start=1):
        progress(f"table {number}/{len(tables)}  {entry.name}")
        compute(entry, records, progress)
        own = rows_of(entry, records)
        rows += own
        for key, one in entry.runs.items():
            cases += _cases(entry, key, records[one], own)
    axes = ("source spacing", "relative L2 error [-]")
    plots = [plot(_TITLES[name], axes, cases, "h", "largest")] if name == "linear" else []
    return {
        "title": _TITLES[name],
        "about": f"{__doc__}",
        "cases": cases,
        "rows": rows,
        "tables": [table("What was wanted beside what was found", list(map(_shown, rows)))],
        "plots": plots,
    }


def _shown(row: dict[str, Any]) -> dict[str, Any]:
    """A row as shown in tables."""
    ratio = row["ratio"]
    return {
        "problem": row["table"],
        **{key: row[key] for key in ("row", "published", "ours")},
        "error": None if ratio is None else abs(ratio - 1.0),
        "CPU [s]": row["cpu_s"],
    }


def _cases(
    entry: Table, key: str, record: dict[str, Any], rows: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Cases of a run: those it names, or itself with the errors of the rows that read it."""
    errors = {
        row["row"]: row["ours"] if row["published"] is None else abs(row["ratio"] - 1.0)
        for given, row in zip(entry.rows, rows, strict=True)
        if given.quantity[0] == key and row["ours"] is not None
    }
    found = []
    for case in record.get("cases", [record]):
        error = case.get("error", errors)
        found.append(
            {
                "problem": entry.name,
                "method": case.get("method", key),
                "size": key,
                "curve": case.get("curve", entry.name),
                "h": case.get("h"),
                "unknowns": case.get("dofs"),
                "iterations": case.get("iterations"),
                "cpu_s": case.get("cpu_s"),
                "error": error,
                "largest": max((e for e in error.values() if e is not None), default=None),
                "outcome": record.get("ended", "converged"),
            }
        )
    return found
