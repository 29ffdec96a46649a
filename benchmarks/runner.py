"""One runner: a row for each problem, form and size, with error, bar, verdict, cost and peer.

    python benchmarks/runner.py NAME... [--quick] [--out DIR]

solves the rows of `trust`, `methods`, `certify`, `unseen`, `layers`, `maps` or `race`
(`methods` is another view of those of `trust`), and writes `NAME.md`, a view of them, and figures
of its curves to `docs/results` or DIR, and all rows to `results.json` there. `myork bench NAME`
writes them to `bench.json`. Of `linear`, `nonlinear` and `rom`, tables of `studies.py`, the runner
writes the page.

    python benchmarks/runner.py truths NAME [[FIRST] LAST]

solves problems of `unseen`, `layers` or `maps` whose truths their file lacks by finite elements.

    python benchmarks/runner.py TABLE [ARGUMENT...]

prints a table of docs/, a function in `benchmarks/tables`, a row as soon as it is known; with
`--write` last its page in `docs/results` takes the rows.

felupe solves the same problems in the same run, bodies of voxels in their true shape; the limit of
its meshes is the truth, with what is not known of it. In `race` dolfinx runs as well, where it is
installed (Debian: `apt install python3-dolfinx`). One thread; processor times include the set-up of
a scene. Most tables take minutes.
"""

from __future__ import annotations

import argparse
import inspect
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.page import body_of
from benchmarks.problems import Problem, probe_kind
from benchmarks.runs import outcome_text, solve_case
from benchmarks.truths.exact import inner_stress
from benchmarks.truths.finite_elements import Warp, solve_deck
from benchmarks.truths.peers import compiled_peers
from benchmarks.voxel_bodies import Body, body_cloud, box_tables
from myork.bench.machine import machine
from myork.bench.runs import read_deck
from myork.console import ProgressCallback
from myork.core.scene import Scene
from myork.errors import ConvergenceError, MyorkError
from myork.files import write_json, write_text
from myork.records import PointCloud
from myork.report.frame import table_lines

#: Kinds of probes
KINDS = ("displacement", "force", "stress", "surface stress")
#: Error from which on an answer must not be accepted [-]
WRONG = 0.05
#: Least size of a probe relative to the largest of its kind [-]
_LEAST = 1e-3
#: Limit of the wall time of one solve [s]
_LIMIT = 300.0
#: Timed solves are repeated up to this total time, and at most this many times [s], [-]
_ENOUGH, _MOST = 1.0, 3
_RESULTS = Path(__file__).parents[1] / "docs" / "results"

#: Tables of each module of `benchmarks/tables`
TABLES = {
    "across": ("across",),
    "real_anatomy": ("real_anatomy",),
    "real_images": ("real_images", "real_muscles"),
    "scaling": ("scaling",),
    "searched": ("searched",),
    "sizes": ("sizes",),
    "solvers": ("solvers",),
    "tissues": ("tissues",),
    "trained": ("trained",),
}
#: Modules whose tables share a page
_IMAGES = ("real_anatomy", "real_images", "tissues")

#: Name of a form, and the overrides that select it
Form = tuple[str, Sequence[str]]


class Truth(NamedTuple):
    """Reference value of a probe, and its uncertainty."""

    value: float
    doubt: float


class Truths(NamedTuple):
    """Reference values of a problem's probes."""

    kinds: Mapping[str, str]  #: Kind of each probe, by name
    values: Mapping[str, Truth]  #: Their truths

    def errors(
        self, probes: Mapping[str, float], bars: Mapping[str, float], least: float = _LEAST
    ) -> dict[str, Any]:
        """Compare an answer.

        - `probes`, `bars`: values and error bars, by name
        - `least`: least size of a probe, relative to the largest of its kind [-]
        - returns `error`, `bar` and `doubt` of the truth by probe, relative; `off`, the largest
          error beyond the doubt; `held`, the number of bars that contain it; `error` followed by a
          kind, the largest of it, or by a name
        """
        most: dict[str, float] = {}
        for name, truth in self.values.items():
            kind = self.kinds[name]
            most[kind] = max(most.get(kind, 0.0), abs(truth.value))
        # probes that vanish by symmetry are compared with others of their kind, like their bars
        size = {
            name: max(abs(truth.value), least * most[self.kinds[name]])
            for name, truth in self.values.items()
            if name in probes
        }
        error = {name: abs(probes[name] - self.values[name].value) / size[name] for name in size}
        bar = {name: bars[name] / size[name] for name in size if bars.get(name) is not None}
        doubt = {name: self.values[name].doubt / size[name] for name in size}
        held = [error[name] <= bar[name] + doubt[name] for name in bar]
        largest = {
            f"error {kind}": max((error[n] for n in error if self.kinds[n] == kind), default=None)
            for kind in KINDS
        }
        return {
            "error": error,
            "bar": bar,
            "doubt": doubt,
            "off": max((max(error[name] - doubt[name], 0.0) for name in error), default=None),
            "held": f"{sum(held)} of {len(held)}" if held else None,
            **{f"error {name}": value for name, value in error.items()},
            **largest,
        }


def rows_of(
    problem: Problem | Body,
    forms: Sequence[Form] | Callable[[Any], Sequence[Form]],
    progress: ProgressCallback,
    *,
    sizes: int | None = None,
    timed: bool = False,
) -> tuple[Truths, list[dict[str, Any]]]:
    """Solve a problem with finite elements and with all forms.

    - `problem`: the problem
    - `forms`: name and overrides of each form, or a function of the size that gives them
    - `sizes`: number of the problem's sizes used; all by default
    - `timed`: solve in this process without output and error bars, short solves repeated; the least
      time counts. Compiled peers also solve the meshes of a `Problem`.
    - returns `truths`: limits of the meshes; for a tube in timed solves, the exact values
    - returns `rows`: `problem`, `form` (and as `method`), `size`, `unknowns`, `cpu_s`, `memory`,
      `outcome`, `verdict`, `reasons`, `peer` (`program`, `size` and `cpu_s` of the cheapest mesh
      with no larger error) and what `Truths.errors` returns; `rival` marks finite elements
    """
    truths, rivals = solve_rivals(problem, progress, timed=timed)
    if timed:
        truths = _exact(problem, truths)
    rows = [
        {
            **_named(problem, "felupe", rival["size"]),
            "rival": True,
            "unknowns": rival["dofs"],
            "outcome": rival["outcome"],
            "cpu_s": rival["cpu_s"],
            **truths.errors(rival["probes"], {}),
        }
        for rival in rivals
    ]
    meshes = list(rows)
    if timed and isinstance(problem, Problem):
        rows += _compiled(problem, truths, progress)
    chosen = {size: forms(size) if callable(forms) else forms for size in problem.sizes[:sizes]}
    for name in dict.fromkeys(name for own in chosen.values() for name, _ in own):
        for size, own in chosen.items():
            words = dict(own).get(name)
            if words is None:
                continue
            text, tables, cloud = _sized(problem, size)
            progress(f"{problem.name}: {name}, {text}")
            if timed:
                solve = _timed_solve(tables, words, cloud)
                case = solve()
                case["cpu_s"] = _least_time(case, solve)
            else:
                case = record_of(solve_case(tables, words, cloud=cloud, limit=_LIMIT))
            found = truths.errors(case.pop("probes"), case.pop("bars", {}))
            peer = _cheapest(meshes, found)
            rows.append({**_named(problem, name, text), **case, **found, "peer": peer})
    return truths, rows


def _compiled(problem: Problem, truths: Truths, progress: ProgressCallback) -> list[dict[str, Any]]:
    """Rows of dolfinx, or a row that reports its absence."""
    progress(f"{problem.name}: dolfinx")
    deck = read_deck(sized_tables(problem.tables, problem.sizes[0]))
    return [
        {
            **_named(problem, row["form"], lattice_text(row.get("elements", ()))),
            "rival": True,
            "unknowns": row.get("dofs"),
            "memory": row.get("memory"),
            "outcome": row.get("outcome", "converged"),
            "cpu_s": row.get("cpu_s"),
            **truths.errors(row.get("probes", {}), {}),
        }
        for row in compiled_peers(deck, problem.elements)
    ]


def _named(problem: Problem | Body, form: str, size: str) -> dict[str, Any]:
    """Common entries of each row, and their names in `bench.json`."""
    empty = {"unknowns": None, "verdict": None, "cpu_s": None, "memory": None, "peer": None}
    return {"problem": problem.name, "form": form, "method": form, "size": size, **empty}


def _cheapest(
    meshes: Sequence[Mapping[str, Any]], found: Mapping[str, Any]
) -> dict[str, Any] | None:
    """The cheapest mesh whose largest error is not larger than that of the answer."""
    if not found["error"]:
        return None
    worst = max(found["error"].values())
    near = [m for m in meshes if m["error"] and max(m["error"].values()) <= worst and m["cpu_s"]]
    if not near:
        return None
    best = min(near, key=lambda mesh: mesh["cpu_s"])
    return {"program": best["form"], "size": best["size"], "cpu_s": best["cpu_s"]}


def solve_rivals(
    problem: Problem | Body,
    progress: ProgressCallback,
    warp: Warp | None = None,
    *,
    timed: bool = False,
) -> tuple[Truths, list[dict[str, Any]]]:
    """Solve a problem on all its meshes.

    - `warp`: moves the nodes of a box within it
    - `timed`: short solves are repeated, and the least time counts
    - returns `truths`: limits of the meshes
    - returns `rivals`: for each mesh `size`, `probes` (empty where the iteration failed), `dofs`,
      `cpu_s` and `outcome`
    """
    if isinstance(problem, Body):
        deck = read_deck(box_tables(problem))
    else:
        deck = read_deck(sized_tables(problem.tables, problem.sizes[0]))
    size = deck["geometry"].get("size")
    kinds = {entry["name"]: probe_kind(entry, size) for entry in deck["probe"]}
    rivals = []
    for count in problem.elements:
        progress(f"{problem.name}: finite elements, {lattice_text(count)}")
        solve = partial(_finite_elements, problem, deck, count, warp)
        found = solve()
        if timed:
            found["cpu_s"] = _least_time(found, solve)
        rivals.append({**found, "size": lattice_text(count)})
    limits = _limits([rival["probes"] for rival in rivals if rival["probes"]])
    return Truths(kinds, limits), rivals


def sized_tables(tables: Mapping[str, Any], size: Sequence[int]) -> dict[str, Any]:
    """Deck with its source points, and collocation points at half their spacing; or without any."""
    if not size:
        return dict(tables)
    places = {"source": list(size), "collocation": [2 * n - 1 for n in size]}
    return {**tables, "geometry": {**tables["geometry"], **places}}


def lattice_text(count: Sequence[int]) -> str:
    """Numbers along the edges in the format of tables."""
    return " x ".join(str(n) for n in count)


def _sized(problem: Problem | Body, size: Any) -> tuple[str, dict[str, Any], PointCloud | None]:
    """Name, deck and points of a size."""
    if isinstance(problem, Body):
        return f"voxels {size:g}", dict(problem.tables), body_cloud(problem, size)
    return lattice_text(size), sized_tables(problem.tables, size), None


def record_of(case: dict[str, Any]) -> dict[str, Any]:
    """Entries kept of a solve in a separate process."""
    verdict = case.get("verdict") or {"state": "refused", "reasons": [case["message"]]}
    return {
        "cpu_s": case.get("cpu_s"),
        "unknowns": case.get("dofs"),
        "memory": case.get("memory_peak_bytes"),
        "outcome": outcome_text(case),
        "verdict": verdict["state"],
        "reasons": verdict["reasons"],
        "probes": case.get("probes") or {},
        "bars": case.get("probe_errors") or {},
    }


def _timed_solve(
    tables: Mapping[str, Any], words: Sequence[str], cloud: PointCloud | None
) -> Callable[[], dict[str, Any]]:
    """A solve in this process on one thread; without time if it fails."""

    def solve() -> dict[str, Any]:
        begin = time.process_time()
        try:
            with Scene.from_tables(tables, cloud, overrides=words, threads=1) as scene:
                states = scene.solve(error=False)
                values = scene.probes(states.x[-1:], states.load[-1:])[0, :, 0]
                unknowns = scene.dofs
        except MyorkError as error:
            return {"probes": {}, "unknowns": None, "cpu_s": None, "outcome": str(error)}
        names = [entry["name"] for entry in tables["probe"]]
        return {
            "cpu_s": time.process_time() - begin,
            "probes": dict(zip(names, values.tolist(), strict=True)),
            "unknowns": unknowns,
            "outcome": "converged",
        }

    return solve


def _least_time(first: Mapping[str, Any], again: Callable[[], Mapping[str, Any]]) -> float | None:
    """Least CPU time over repeated solves [s]."""
    times = [] if first["cpu_s"] is None else [first["cpu_s"]]
    while times and sum(times) < _ENOUGH and len(times) < _MOST:
        times.append(again()["cpu_s"] or times[0])
    return min(times, default=None)


def _finite_elements(
    problem: Problem | Body, deck: Mapping[str, Any], count: Sequence[int], warp: Warp | None
) -> dict[str, Any]:
    """Last values of the probes, empty if the iteration failed."""
    body = problem if isinstance(problem, Body) else None
    try:
        rival = solve_deck(
            deck, count, labels=body.part if body else None, warp=body.warp if body else warp
        )
    except ConvergenceError as error:
        return {"probes": {}, "dofs": None, "cpu_s": None, "outcome": str(error)}
    return {**rival, "outcome": "converged"}


def _limits(found: Sequence[Mapping[str, float]]) -> dict[str, Truth]:
    """Limit of the meshes and its doubt, which is what the finest mesh changed of the limit."""
    truths = {}
    for name in found[-1] if found else ():
        values = [probes[name] for probes in found]
        last = _aitken(values[-3:])
        before = _aitken(values[-4:-1]) if len(values) > 3 else None
        if last is None:
            truths[name] = Truth(values[-1], abs(values[-1] - [0.0, *values][-2]))
        else:
            truths[name] = Truth(last, abs(last - (values[-1] if before is None else before)))
    return truths


def _aitken(values: Sequence[float]) -> float | None:
    """Limit of three values, or none where their changes do not decrease."""
    if len(values) < 3:
        return None
    before, change = values[1] - values[0], values[2] - values[1]
    if not (change * before > 0.0 and abs(change) < 0.7 * abs(before)):
        return None
    return values[-1] + change * change / (before - change)


def _exact(problem: Problem | Body, truths: Truths) -> Truths:
    """For a tube the exact values: the cut carries the pressure on the bore."""
    if isinstance(problem, Body) or problem.tables["geometry"]["kind"] != "annulus":
        return truths
    deck = read_deck(sized_tables(problem.tables, problem.sizes[0]))
    wall = inner_stress(deck)
    moved = next(entry["radial"] for entry in deck["boundary"] if entry.get("radial") is not None)
    known = {"wall": wall, "force": wall * (deck["geometry"]["inner_radius"] + moved)}
    exact = {name: Truth(value, 1e-8 * abs(value)) for name, value in known.items()}
    return truths._replace(values={**truths.values, **exact})


# ---- what is written -----------------------------------------------------------------------------


def main(*words: str) -> None:
    """Solve rows and write their views, or print a table."""
    modules = {table: module for module, tables in TABLES.items() for table in tables}
    if words and words[0] in modules:
        _print_table(modules[words[0]], words[0], words[1:])
        return
    from benchmarks import pivots, studies, unseen

    if words[:1] == ("truths",) and words[1:2] and words[1] in pivots.RANDOM:
        module = pivots.RANDOM[words[1]]
        numbers = range(*map(int, words[2:])) if words[2:] else module.NUMBERS
        unseen.fill(module.TRUTHS, module.wanted(numbers))
        return

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = [*pivots.PIVOTS, *studies.STUDIES, *modules]
    parser.add_argument("names", metavar="NAME", nargs="+", choices=names)
    parser.add_argument("--quick", action="store_true", help="small cases only")
    parser.add_argument("--out", type=Path, default=_RESULTS, help="folder; docs/results")
    options = parser.parse_args(words)
    options.out.mkdir(parents=True, exist_ok=True)
    solved: dict[str, Any] = {}
    kept = ("problem", "form", "size", "unknowns", "error", "bar", "verdict", "cpu_s", "memory")
    # `trust` and `methods` show the same rows
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    for name in options.names:
        if name in studies.STUDIES:
            shown = studies.run(name, print, options.quick)
        else:
            shown = pivots.view(name, print, options.quick, solved=solved)
            rows |= {
                (row["problem"], row["form"], row["size"]): {
                    key: row.get(key) for key in (*kept, "peer")
                }
                for row in shown["cases"]
            }
            write_json(options.out / "results.json", list(rows.values()))
        write_text(options.out / f"{name}.md", _markdown(name, shown, options))
        print(options.out / f"{name}.md")


def _markdown(name: str, shown: Mapping[str, Any], options: argparse.Namespace) -> str:
    """A page of results."""
    about = machine()
    call = f"python benchmarks/runner.py {name}{' --quick' if options.quick else ''}"
    text, pictures = body_of(name, shown)
    for picture, drawn in pictures.items():
        drawn.savefig(options.out / picture, dpi=75)
    return (
        f"# {shown['title']}\n\n"
        f"Written by `{call}` on {about['date'][:10]} (MyoRK {about['version']}, "
        f"{about['processor']}, one thread, load of the machine {about['load_average']:.1f}). "
        f"{shown['about']}\n{text}"
    )


def _print_table(module: str, name: str, arguments: Sequence[str]) -> None:
    """Print the rows of a table of docs/, or its usage."""
    table: Callable[..., Any] = getattr(import_module(f"benchmarks.tables.{module}"), name)
    wanted, write = inspect.signature(table), arguments[-1:] == ("--write",)
    arguments = arguments[:-1] if write else arguments
    try:
        wanted.bind(*arguments)
    except TypeError:
        sys.exit(f"{name}{wanted}\n\n{inspect.getdoc(table)}")
    about = machine()
    print(f"MyoRK {about['version']}\n\n## {name}\n\n{inspect.getdoc(table)}\n", flush=True)
    rows = []
    for row in table(*arguments):
        rows.append(list(row))
        print("\n".join(table_lines(rows)[0 if len(rows) == 1 else -1 :]), flush=True)
    if write:
        # do not publish the users' folders
        words = [name, *("DATA" if "data" in wanted.parameters else word for word in arguments)]
        call = f"`python benchmarks/runner.py {' '.join(words)} --write`"
        written = f"{call}: {about['processor']}, {about['date'][:10]}."
        page = "images" if module in _IMAGES else module
        write_table(_RESULTS / f"{page}.md", name, inspect.getdoc(table) or "", rows, written)


def write_table(
    page: Path, name: str, about: str, rows: Sequence[Sequence[str]], written: str
) -> None:
    """Put a table into a page in place of its earlier rows; its parts are in alphabetical order."""
    text = page.read_text(encoding="utf-8") if page.is_file() else f"# {name.capitalize()}\n"
    head, *parts = text.rstrip("\n").split("\n\n## ")
    kept = {part.partition("\n")[0]: part for part in parts}
    kept[name] = "\n".join([name, "", about, "", *table_lines(rows), "", written])
    write_text(page, "\n\n## ".join([head, *(kept[key] for key in sorted(kept))]) + "\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
