"""Tables of a report: every number with its unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from myork.report.frame import table
from myork.report.numbers import DASH, fraction, labelled, number, unit_of, with_error
from myork.summary import printed

__all__ = [
    "MODEL_KINDS",
    "exact_table",
    "label_table",
    "orientation_table",
    "probe_table",
    "reference_table",
    "rom_table",
    "run_table",
    "timing_table",
]

#: Kinds of reduced models as the summary names them
MODEL_KINDS = {"galerkin": "Galerkin", "reduced": "reduced assembly", "hyper": "hyper-reduced"}
_STAGES = {
    "shape": "shape functions",
    "assemble": "assembly",
    "solve": "linear solver",
    "output": "output",
}


def run_table(summary: Mapping[str, Any]) -> Markup:
    """What was solved and how: method, sizes, solver, backward error."""
    units = summary.get("units", {})
    solver = summary.get("solver", {})
    used = str(solver.get("used", DASH))
    if solver.get("asked") not in (None, solver.get("used")):
        used += f" (asked: {solver['asked']})"
    if solver.get("why"):
        used = Markup("{}<br><small>{}</small>").format(used, solver["why"])
    rows: list[tuple[str, str]] = [
        ("method", str(summary.get("method", DASH))),
        ("dimension", _dimension(summary.get("dimension"))),
        ("source points", number(summary.get("source_points"))),
        ("collocation points", number(summary.get("collocation_points"))),
        ("unknowns", number(summary.get("dofs"))),
        ("equations (rows)", number(summary.get("rows"))),
        ("linear solver", used),
        ("condition number of the rows, about", number(_inverse(solver), 2)),
        ("backward error, largest", number(solver.get("backward_error"), 2)),
        ("load steps, iterations", _iterations(summary.get("steps", []))),
        ("threads", number(summary.get("threads"))),
        ("units", ", ".join(f"{key} {unit}" for key, unit in units.items()) or DASH),
    ]
    if summary.get("sets"):
        lines = [
            f"{own.get('name')}: {own.get('boundary_points')} boundary points, "
            + Markup("{} {}").format(number(own.get("area")), unit_of(own, "unit"))
            for own in summary["sets"]
        ]
        rows.append(("sets of the deck", Markup("<br>").join(lines)))
    overrides = summary.get("overrides")
    if overrides:
        rows.append(("changed with --set", Markup("<br>").join(str(line) for line in overrides)))
    rows.append(
        ("deck, SHA-256", Markup("<code>{}</code>").format(summary.get("deck_sha256", DASH)))
    )
    return table((), [row for row in rows if row[1] != DASH])


def probe_table(steps: Sequence[Mapping[str, Any]], units: Mapping[str, str]) -> Markup:
    """Values of all probes, a line a step.

    Parameters
    ----------
    steps : Sequence of Mapping
        `steps` of the summary.
    units : Mapping
        Unit of each probe by its name.

    Returns
    -------
    Markup
        HTML.
    """
    head = ["load [-]", *(labelled(name, unit) for name, unit in units.items())]
    rows = [
        [
            fraction(step.get("load")),
            *(
                with_error(printed(step).get(name), step.get("probe_errors", {}).get(name))
                for name in units
            ),
        ]
        for step in steps
    ]
    return table(head, rows)


def exact_table(exact: Mapping[str, Any], units: Mapping[str, str]) -> Markup:
    """Values beside their exact solutions, both at full load."""
    rows = [
        (
            labelled(name, units.get(name, "")),
            number(entry.get("value"), 6),
            number(entry.get("reference"), 6),
            number(entry.get("relative_error"), 2),
        )
        for name, entry in exact.items()
    ]
    head = ("quantity", "computed", "exact", "relative error [-]")
    return table(head, rows, "Exact solutions at full load")


def reference_table(reference: Mapping[str, Any], units: Mapping[str, str]) -> Markup:
    """Largest distance of each probe from reference values."""
    rows = []
    for name, entry in reference.items():
        values, theirs = _numbers(entry.get("value")), _numbers(entry.get("reference"))
        errors = _numbers(entry.get("relative_error"))
        rows.append(
            (
                labelled(name, units.get(name, "")),
                number(len(theirs)),
                number(values[-1] if values else None),
                number(theirs[-1] if theirs else None),
                number(max((abs(error) for error in errors), default=None), 2),
                str(entry.get("source", DASH)),
            )
        )
    head = (
        "probe", "points", "computed, last", "reference, last", "largest relative error [-]",
        "source of the reference",
    )  # fmt: skip
    return table(head, rows, "Distance from reference values")


def rom_table(models: Sequence[Mapping[str, Any]]) -> Markup:
    """Errors, times and speed-up of the reduced models, side by side."""
    head = (
        "model", "modes r", "points", Markup("e<sub>1</sub> displacement [-]"),
        Markup("e<sub>2</sub> gradient [-]"), "stress error [-]", "force error [-]", "offline [s]",
        "online, a state [ms]", "speed-up over full", "speed-up over DGELS",
    )  # fmt: skip
    rows = []
    for model in models:
        online = model.get("online_s_per_state")
        rows.append(
            (
                MODEL_KINDS.get(str(model.get("kind")), str(model.get("kind"))),
                number(model.get("r")),
                number(model.get("points")),
                *(number(model.get(key), 2) for key in ("e1", "e2", "stress_error", "force_error")),
                number(model.get("offline_s"), 3),
                number(None if online is None else 1000.0 * online, 3),
                number(model.get("speedup_vs_full"), 3),
                number(model.get("speedup_vs_dgels"), 3),
            )
        )
    return _known(head, rows, 0, "Reduced models against the full solution")


def _known(head: Sequence[str], rows: Sequence[Sequence[str]], first: int, caption: str) -> Markup:
    """A table without the columns, from one on, in which all entries are dashes."""
    shown = [k for k in range(len(head)) if k < first or any(row[k] != DASH for row in rows)]
    kept = [[row[k] for k in shown] for row in rows]
    return table([head[k] for k in shown], kept, caption)


def orientation_table(evidence: Sequence[Mapping[str, Any]], shown: int = 4) -> Markup:
    """Evidence for the order of the gradient axes: a table where another one agrees better."""
    given, *others = evidence
    others.sort(key=lambda o: (-round(o.get("agreement") or 0.0, 1), o.get("crossing") or 0.0))
    mine = given.get("agreement")
    if mine is not None and round(mine, 1) >= round(others[0].get("agreement") or 0.0, 1):
        return Markup(
            "<p>Gradient axes {}, as in the files: agreement with the anatomy {}, fibers cross "
            "walls by {}; none of {} other orders agrees better.</p>"
        ).format(given["axes"], number(mine, 2), number(given.get("crossing"), 2), len(others))
    rows = [
        (entry["axes"], number(entry.get("crossing"), 2), number(entry.get("agreement"), 2))
        for entry in (given, *others[:shown])
    ]
    head = ("gradient axes", "fibers cross walls [-]", "agreement with anatomy [-]")
    caption = (
        "Order of the gradient axes: of the files, and the best others. Fibers cross walls: mean "
        "square cosine with their normals, small where they run along; flips and the two axes "
        "across a muscle hardly change it"
    )
    return table(head, rows, caption)


def label_table(segmentation: Mapping[str, Any], units: Mapping[str, str]) -> Markup:
    """Size and, where the truth is known, scores of each label."""
    labels, scores = segmentation.get("labels", {}), segmentation.get("scores", {})
    digits = {"pixels": 4, "volume": 4, "dice": 3, "pcc": 3, "fat_fraction": 3,
              "volume_of_parts": 4}  # fmt: skip
    unit = unit_of(units, "volume")
    head = ("label", "voxels", f"volume [{unit}]", "Dice [-]", "PCC [-]", "fraction of fat [-]",
            f"volume of parts [{unit}]")  # fmt: skip
    rows = []
    for name in dict.fromkeys([*labels, *scores]):
        own = {**labels.get(name, {}), **scores.get(name, {})}
        rows.append([name, *(number(own.get(key), n) for key, n in digits.items())])
    caption = "Labels of the segmentation (a dash: no truth to score against)"
    maps = segmentation.get("maps") or {}
    if maps:
        caption += "; maps in this folder: " + ", ".join(maps.values())
    return _known(head, rows, 5, caption)


def timing_table(timings: Mapping[str, Any], memory: Any) -> Markup:
    """Seconds of each stage with its share, and the largest memory."""
    total = timings.get("total")
    rows: list[tuple[str, str, str]] = []
    for key, seconds in timings.items():
        if key == "total":
            continue
        share = 100.0 * seconds / total if seconds is not None and total else None
        rows.append((_STAGES.get(key, key), number(seconds, 3), number(share, 2)))
    rows.append(("total", number(total, 3), number(100 if total else None)))
    if memory is not None:
        rows.append(("memory, largest", Markup("{} MiB").format(number(memory / 2**20, 3)), ""))
    return table(("stage", "wall time [s]", "share [%]"), rows, "Where the time went")


def _inverse(solver: Mapping[str, Any]) -> float | None:
    small = solver.get("reciprocal_condition")
    return 1.0 / small if small else None


def _dimension(dimension: Any) -> str:
    return {2: "2 (plane strain)", 3: "3"}.get(dimension, DASH)


def _iterations(steps: Sequence[Mapping[str, Any]]) -> str:
    if not steps:
        return DASH
    total = sum(step.get("iterations") or 0 for step in steps)
    return Markup("{} steps, {} iterations").format(number(len(steps)), number(total))


def _numbers(values: Any) -> list[float]:
    return [value for value in values or () if isinstance(value, (int, float))]
