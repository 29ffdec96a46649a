"""Tables of a report: every number with its unit."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from markupsafe import Markup

from myork.report.frame import table
from myork.report.numbers import DASH, fraction, labelled, number, typeset, unit_of, with_error
from myork.summary import printed


def run_table(summary: Mapping[str, Any]) -> Markup:
    """Problem and method of a run: method, sizes, solver, backward error."""
    rows = [(name, cell(summary)) for name, cell in _FACTS.items()]
    shown = [row for row in rows if row[1] != DASH]
    return Markup('<div class="facts">{}</div>').format(table((), shown))


def _of(key: str, digits: int = 4) -> Callable[[Mapping[str, Any]], Markup]:
    """A number of an entry."""
    return lambda own: number(own.get(key), digits)


def _solver(summary: Mapping[str, Any]) -> str:
    solver = summary.get("solver", {})
    used = str(solver.get("used", DASH))
    if solver.get("asked") not in (None, solver.get("used")):
        used += f" (asked: {solver['asked']})"
    return (
        Markup("{}<br><small>{}</small>").format(used, solver["why"]) if solver.get("why") else used
    )


def _condition(summary: Mapping[str, Any]) -> Markup:
    small = summary.get("solver", {}).get("reciprocal_condition")
    return number(1.0 / small if small else None, 2)


def _iterations(summary: Mapping[str, Any]) -> str:
    steps = summary.get("steps", [])
    total = sum(step.get("iterations") or 0 for step in steps)
    plural = "" if len(steps) == 1 else "s"
    words = Markup("{} step{}, {} iterations").format(number(len(steps)), plural, number(total))
    return words if steps else DASH


def _sets(summary: Mapping[str, Any]) -> str:
    lines = [
        f"{own.get('name')}: {own.get('boundary_points')} boundary points, "
        + Markup("{} {}").format(number(own.get("area")), unit_of(own, "unit"))
        for own in summary.get("sets", [])
    ]
    return Markup("<br>").join(lines) or DASH


def _times(summary: Mapping[str, Any]) -> str:
    parts = summary.get("timings_s", {}).items()
    return Markup(", ").join(Markup("{} {}").format(k, number(s, 3)) for k, s in parts) or DASH


def _memory(summary: Mapping[str, Any]) -> str:
    peak = summary.get("memory_peak_bytes")
    return DASH if peak is None else Markup("{} MiB").format(number(peak / 2**20, 3))


#: Rows of the table of a run: quantities from the summary
_FACTS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "method": lambda own: str(own.get("method") or DASH),
    "dimension": lambda own: {2: "2 (plane strain)", 3: "3"}.get(own.get("dimension") or 0, DASH),
    "source points": _of("source_points"),
    "collocation points": _of("collocation_points"),
    "unknowns": _of("dofs"),
    "equations (rows)": _of("rows"),
    "linear solver": _solver,
    "condition number of the rows, about": _condition,
    "backward error, largest": lambda own: number(own.get("solver", {}).get("backward_error"), 2),
    "load steps, iterations": _iterations,
    "threads": _of("threads"),
    "wall time [s]": _times,
    "memory, largest": _memory,
    "units": lambda own: (
        ", ".join(f"{k} {typeset(u)}" for k, u in own.get("units", {}).items()) or DASH
    ),
    "sets of the deck": _sets,
    "changed with --set": lambda own: Markup("<br>").join(own.get("overrides", ())) or DASH,
    "deck, SHA-256": lambda own: (
        Markup("<code>{}</code>").format(own["deck_sha256"]) if own.get("deck_sha256") else DASH
    ),
}


def probe_table(steps: Sequence[Mapping[str, Any]], units: Mapping[str, str]) -> Markup:
    """Values of all probes, a row for each step, or for each probe where there are more of them.

    - `units`: by names of probes
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
    if len(steps) < len(units):
        head, *rows = map(list, zip(head, *rows, strict=True))
    return table(head, rows)


def _listed(
    entries: Iterable[Mapping[str, Any]],
    columns: Mapping[str, Callable[[Mapping[str, Any]], str]],
    caption: str,
    always: int = 0,
) -> Markup:
    """One row per entry; after the first few, columns of dashes are left out."""
    rows = [[cell(own) for cell in columns.values()] for own in entries]
    shown = [k for k in range(len(columns)) if k < always or any(row[k] != DASH for row in rows)]
    heads = [list(columns)[k] for k in shown]
    return table(heads, [[row[k] for k in shown] for row in rows], caption)


def exact_table(exact: Mapping[str, Any], units: Mapping[str, str]) -> Markup:
    """Values beside their exact solutions, both at full load."""
    columns = {
        "quantity": lambda own: labelled(own["name"], units.get(own["name"], "")),
        "computed": _of("value", 6),
        "exact": _of("reference", 6),
        "relative error [-]": _of("relative_error", 2),
    }
    return _listed(_named(exact), columns, "Exact solutions at full load", 4)


def reference_table(reference: Mapping[str, Any], units: Mapping[str, str]) -> Markup:
    """Largest distance of each probe from reference values."""
    columns = {
        "probe": lambda own: labelled(own["name"], units.get(own["name"], "")),
        "points": lambda own: number(len(_numbers(own, "reference"))),
        "computed, last": lambda own: number(next(reversed(_numbers(own, "value")), None)),
        "reference, last": lambda own: number(next(reversed(_numbers(own, "reference")), None)),
        "largest relative error [-]": lambda own: number(
            max(map(abs, _numbers(own, "relative_error")), default=None), 2
        ),
        "source of the reference": lambda own: str(own.get("source", DASH)),
    }
    return _listed(_named(reference), columns, "Differences from reference values", 6)


def _named(entries: Mapping[str, Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    return ({**own, "name": name} for name, own in entries.items())


def _numbers(entry: Mapping[str, Any], key: str) -> list[float]:
    return [value for value in entry.get(key, ()) if isinstance(value, (int, float))]


def rom_table(models: Sequence[Mapping[str, Any]]) -> Markup:
    """Errors, times and speed-up of the reduced models, side by side."""
    columns = {
        "model": lambda own: str(own.get("kind")),
        "modes r": _of("r"),
        "points": _of("points"),
        Markup("e<sub>1</sub> displacement [-]"): _of("e1", 2),
        Markup("e<sub>2</sub> gradient [-]"): _of("e2", 2),
        "stress error [-]": _of("stress_error", 2),
        "force error [-]": _of("force_error", 2),
        "offline [s]": _of("offline_s", 3),
        "online, per state [ms]": lambda own: number(
            None if own.get("online_s_per_state") is None else 1e3 * own["online_s_per_state"], 3
        ),
        "speed-up over full": _of("speedup_vs_full", 3),
    }
    return _listed(models, columns, "Reduced models against the full solution")


def label_table(segmentation: Mapping[str, Any], units: Mapping[str, str]) -> Markup:
    """Size and, where the truth is known, scores of each label."""
    labels, scores = segmentation.get("labels", {}), segmentation.get("scores", {})
    unit = unit_of(units, "volume")
    columns = {
        "label": lambda own: own["name"],
        "voxels": _of("pixels"),
        f"volume [{unit}]": _of("volume"),
        "Dice [-]": _of("dice", 3),
        "PCC [-]": _of("pcc", 3),
        "fat fraction [-]": _of("fat_fraction", 3),
        f"volume by fractions [{unit}]": _of("volume_of_parts"),
    }
    caption = "Labels of the segmentation (a dash: no truth to score against)"
    if maps := segmentation.get("maps"):
        caption += "; maps in this folder: " + ", ".join(maps.values())
    both = {name: {**labels.get(name, {}), **scores.get(name, {})} for name in {**labels, **scores}}
    return _listed(_named(both), columns, caption, 5)


def muscle_table(muscles: Sequence[Mapping[str, Any]]) -> Markup:
    """Numbers of each muscle of the label map; their names contain units."""
    heads = dict.fromkeys(head for own in muscles for head in own if head != "muscle")
    columns = {
        "muscle": lambda own: own["muscle"],
        **{typeset(head): _of(head, 3) for head in heads},
    }
    caption = (
        "Muscles of the label map (muscles.csv): largest section across the long axis; medians of "
        "FA, MD, length of fibers and pennation; PCSA is volume times cosine of pennation over "
        "length of fibers"
    )
    return _listed(muscles, columns, caption, 3)
