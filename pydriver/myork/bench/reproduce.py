"""Tables and figures of the dissertation, computed again from decks of the package.

`dissertation` lists, as data, what is computed and from which deck. One loop runs the requested
tables and prints our numbers beside the published ones.
"""

from __future__ import annotations

import contextlib
import resource
import shlex
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from myork.bench.dissertation import MODES, TABLES, WITHOUT_NUMBERS, Row, Run, Table
from myork.bench.linear import Study, study_rates
from myork.bench.machine import machine
from myork.bench.phantoms import (
    AGED,
    CONNECTIVE,
    GASTROCNEMIUS,
    OLD,
    YOUNG,
    aged_cloud,
    gastrocnemius,
    inclined,
    labelled,
)
from myork.bench.runs import read_deck, solved
from myork.console import ProgressCallback, silent
from myork.core.scene import Scene
from myork.errors import ConvergenceError, InputError, MyorkError
from myork.files import INPUTS, alone_in, write_figure, write_json, write_text
from myork.imaging.io import read_image, read_labels
from myork.records import Labels
from myork.report.frame import page_of_markdown, table_lines
from myork.results import Results
from myork.rom.basis import proper_orthogonal_modes
from myork.rom.study import PathStates, reduced_path
from myork.segmentation.scores import dice
from myork.stations.build import build
from myork.stations.segment import segment
from myork.types import F64

#: A number that is further from the published one needs a reason
FAR = 0.2
#: Runs longer than this are announced as long [s]
_LONG = 60.0

Record = Mapping[str, Any]


# ---- what runs compute ---------------------------------------------------------------------------


def _deck(run: Run, progress: ProgressCallback) -> Record:
    """Values of a deck, materials by name."""
    values = read_deck(run.deck, run.overrides)
    return values | {"material": {entry["name"]: entry for entry in values["material"]}}


def _solve(run: Run, progress: ProgressCallback) -> Record:
    """A solve of a deck; `two` are the times of shape functions and two iterations [s]."""
    case = solved(run.deck, run.overrides, look=_last_fields)
    # parts are measured in wall time: on a shared machine the process gets only a share of it
    share = case["cpu_s"] / case["timings_s"]["total"]
    of_two = 2.0 / max(case["iterations"], 1)
    factors = {"shape": share, "assemble": of_two * share, "solve": of_two * share}
    two = {part: factor * case["timings_s"][part] for part, factor in factors.items()}
    return case | {"two": two | {"total": sum(two.values())}}


def _last_fields(folder: Path) -> Record:
    """Deformed positions of the points, shape `(n, 3)`, and their stress, shape `(n, 3, 3)`."""
    with Results(folder) as results:
        if "cauchy" not in results.fields:
            return {}
        return {"ends": results.deformed(), "cauchy": results.field("cauchy")}


def _rates(run: Run, progress: ProgressCallback) -> Record:
    """Rates of convergence in L2 and H1."""
    assert isinstance(run.more, Study)
    found = study_rates(run.more)
    for case in found["cases"]:
        case["error"] = {norm: case["errors"][f"relative_{norm}"] for norm in ("L2", "H1")}
    return found


def _segment(run: Run, progress: ProgressCallback) -> Record:
    """Dice and Pearson's coefficient of the gastrocnemius: means over its slices, and two slices.

    The two slices lie at the same relative height as slices 15 and 30 of the dissertation's 33.
    """
    with tempfile.TemporaryDirectory(prefix="myork-") as folder:
        out = Path(folder)
        found = segment(INPUTS / f"{run.deck}.toml", out, threads=1, progress=progress)
        record: dict[str, Any] = {
            "anatomy": read_image(out / "anatomy.nii.gz"),
            "found": _gastrocnemius(read_labels(out / "segmentation.nii.gz")),
            "truth": _gastrocnemius(read_labels(out / "truth.nii.gz")),
        }
    return record | by_slice(found["segmentation"]["scores"]["medial_gastrocnemius"])


def by_slice(score: Record) -> dict[str, float]:
    """Means over slices, and values at the places of the dissertation's slices 15 and 30 of 33."""
    count = len(score["dice_by_slice"])
    places = {number: round((number - 0.5) / 33 * count - 0.5) for number in (15, 30)}
    record: dict[str, float] = {}
    for key in ("dice", "pcc"):
        slices = np.array(score[f"{key}_by_slice"], float)
        # the coefficient of an empty slice is not a number
        record[key] = float(np.nanmean(slices)) if np.isfinite(slices).any() else np.nan
        record |= {f"{key}_{number}": float(slices[k]) for number, k in places.items()}
    return record


def _gastrocnemius(labels: Labels) -> Labels:
    """The gastrocnemius as label 1; it is label 1 in the ground truth of all muscles."""
    found = (n for n, name in labels.names.items() if name == "medial_gastrocnemius")
    return replace(labels, data=(labels.data == next(found, 1)).astype(np.int32))


def _tissue(run: Run, progress: ProgressCallback) -> Record:
    """Dice of fat and connective tissue of a leg, and of the latter by fuzzy clustering alone."""
    with tempfile.TemporaryDirectory(prefix="myork-") as folder:
        out = Path(folder)
        found = segment(INPUTS / f"{run.deck}.toml", out, threads=1, progress=progress)
        record: dict[str, Any] = {"anatomy": read_image(out / "connective.nii.gz")}
        for name, file in (("found", "tissue"), ("truth", "true_tissue")):
            labels = read_labels(out / f"{file}.nii.gz")
            record[name] = replace(labels, data=(labels.data == CONNECTIVE).astype(np.int32))
        clusters = read_image(out / "membership_connective_tissue.nii.gz").data > 0.5
    scores = {name: score["dice"] for name, score in found["tissue"]["scores"].items()}
    return record | scores | {"dice_clusters": dice(clusters, record["truth"].data > 0)}


def _aged(run: Run, progress: ProgressCallback) -> Record:
    """Young or old muscle at full activation: force at its top [N], image volumes [cm^3]."""
    name, _, pixels = str(run.more).partition(", ")
    muscle, block = {"young": YOUNG, "old": OLD}[name], int(pixels.split()[0]) if pixels else 4
    labels, _ = labelled(muscle)
    bare, _ = labelled(replace(muscle, layer=0.0))
    case = solved(AGED, run.overrides, cloud=aged_cloud(muscle, block))
    voxel = labels.spacing.prod() / 1000.0
    images = {
        name: float((labels.data == number).sum() * voxel)
        for number, name in labels.names.items()
        if (labels.data == number).any()
    }
    force = case["probes"]["top"]
    # connective tissue inside the muscle, without the aponeurosis around it
    imct = float((bare.data == CONNECTIVE).sum() * voxel)
    return case | {
        "images": images | {"imct": imct},
        "force": force,
        "force_per_volume": force / sum(images.values()),
    }


def _fibers(run: Run, progress: ProgressCallback) -> Record:
    """A gastrocnemius with its fibers, or with one direction at an angle [degree] to the axis."""
    cloud = gastrocnemius()
    if run.more != "measured":
        mean = cloud.fiber[cloud.label == 1].mean(axis=0)
        cloud = gastrocnemius(inclined(mean / np.linalg.norm(mean), float(str(run.more))))
    return solved(GASTROCNEMIUS, ("load.steps=5", *run.overrides), cloud=cloud)


def _motion(run: Run, progress: ProgressCallback) -> Record:
    """Error e1 of a motion by number of modes, with a Cholesky factor as published."""
    with Scene(INPUTS / f"{run.deck}.toml", run.overrides, threads=1) as scene:
        states = scene.solve(error=False)
        full = PathStates.of(scene, states.x, states.load)
        modes, _ = proper_orthogonal_modes(states.x)
        own = _strong(scene)
        return {str(r): reduced_path(scene, full, modes[:, :r], published=own) for r in MODES}


def _strong(scene: Scene) -> bool:
    """Whether the equations are those of collocation, for which a Cholesky factor is published."""
    return str(scene.deck["scene"]["method"]).startswith("rkcm")


def _path(run: Run, progress: ProgressCallback) -> Record:
    """Errors and times along a load path, of the full model and by number of modes.

    Collocation rows are assembled in full and projected, and a Cholesky factor is used. For
    comparison: rows in the span of the modes (`span`), and the time of the full model by `auto`
    beside that by dense QR, which is the time of one iteration times the number of iterations.
    """
    assert isinstance(run.more, tuple)
    with tempfile.TemporaryDirectory(prefix="myork-") as folder:
        if run.deck == "mg_muscle":
            for station in (segment, build):
                words = [w for w in run.overrides if w.startswith(("phantom", "image", "build"))]
                station(INPUTS / "mg_muscle.toml", Path(folder), overrides=words, threads=1)
        with Scene(INPUTS / f"{run.deck}.toml", run.overrides, Path(folder), threads=1) as scene:
            progress(f"{run.deck}: full model, {scene.dofs} unknowns")
            before = time.process_time()
            states = scene.solve(error=False)
            auto = time.process_time() - before
            full = PathStates.of(scene, states.x, states.load)
            modes, _ = proper_orthogonal_modes(states.x)
            published = _strong(scene)
            ways = {"": True, "span ": False} if published else {"": False}
            record: dict[str, Any] = {}
            for (way, whole), r in product(ways.items(), run.more):
                progress(f"{run.deck}: {way}r = {r}")
                record[f"{way}{r}"] = reduced_path(scene, full, modes[:, :r], published=whole)
            dense = auto
            if published:
                progress(f"{run.deck}: an iteration by dense QR")
                # last, because the scene keeps its single load step
                dense = _dense_iteration(scene, states.x[-1]) * int(states.iterations.sum())
    for entry in record.values():
        entry |= {"cpu_min": entry["cpu_s"] / 60, "saved": 100 * (1 - entry["cpu_s"] / dense)}
    return record | {"full": {"cpu_min": dense / 60, "auto_min": auto / 60}}


def _dense_iteration(scene: Scene, start: F64) -> float:
    """Processor time of an iteration at full load by dense QR [s]."""
    scene.update({"load.steps": 1, "load.max_halvings": 0, "solver.max_iterations": 1})
    before = time.process_time()
    # one iteration seldom converges, and need not
    with contextlib.suppress(ConvergenceError):
        scene.solve("dgels", error=False, start=start)
    return time.process_time() - before


#: Functions by kind of run; each returns a record with the quantities of its rows
RUNS: dict[str, Callable[..., Record]] = {
    "deck": _deck,
    "solve": _solve,
    "rates": _rates,
    "segment": _segment,
    "tissue": _tissue,
    "aged": _aged,
    "fibers": _fibers,
    "motion": _motion,
    "path": _path,
}


# ---- the loop ------------------------------------------------------------------------------------


def find_tables(names: Sequence[str]) -> list[Table]:
    """Tables and figures by their names.

    - `names`: `6.8`, `table-6.8`, `figure-5.2`, or `all`. A bare number is the table of that
      number, or the figure where there is no such table.
    - raises InputError: there is no such table or figure, or it has no numbers
    """
    if "all" in names:
        return sorted(TABLES.values(), key=lambda table: table.cost_s)
    found = {}
    for name in names:
        plain = name.strip().lower().removeprefix("table-").removeprefix("table ")
        plain = plain.replace("figure ", "figure-")
        key = next((key for key in (plain, f"figure-{plain}") if key in TABLES), None)
        if key is None:
            close = ", ".join(get_close_matches(plain, TABLES, 3, 0.0))
            raise InputError(
                f"the dissertation has no table or figure {name!r} with numbers; the nearest are "
                f"{close}; `myork reproduce --list` names all, and where those without numbers are "
                "seen"
            )
        found[key] = TABLES[key]
    return list(found.values())


def list_tables() -> str:
    """All tables and figures with numbers, their decks and costs, then those without numbers."""
    lines = [f"{'name':<12} {'CPU [s]':>8}  {'deck':<21} what"]
    for entry in TABLES.values():
        decks = list(dict.fromkeys(run.deck for run in entry.runs.values()))
        long = "  (long)" if entry.cost_s > _LONG else ""
        lines.append(f"{entry.name:<12} {entry.cost_s:>8g}  {decks[0]:<21} {entry.title}{long}")
        lines += [f"{'':<23} {deck}" for deck in decks[1:]]
    lines += ["", "figures without numbers:"]
    lines += [f"  {figures}: {place}" for figures, place in WITHOUT_NUMBERS.items()]
    return "\n".join(lines)


def reproduce(
    names: Sequence[str],
    out: Path,
    *,
    progress: ProgressCallback = silent,
    show: Callable[[str], None] = silent,
) -> dict[str, Any]:
    """Compute tables and figures again, and compare ours with the published numbers.

    - `names`: as in `find_tables`
    - `out`: folder of `reproduce.json`, `reproduce.md` and `reproduce.html`
    - `show`: called with the text of each finished table
    - returns content of `reproduce.json`: `rows`, each with `table`, `row`, `published`, `ours`,
      `ratio`, `cpu_s` (of the runs that the row reads), `note` and, where there is no number,
      `ended`
    - raises InputError: a name is unknown
    """
    wanted = find_tables(names)
    order = [entry for entry in TABLES.values() if entry in wanted]
    records: dict[Run, Record] = {}
    rows: dict[str, list[dict[str, Any]]] = {}
    pictures: dict[str, Figure] = {}
    content = machine()
    with alone_in(out):
        for number, entry in enumerate(wanted, start=1):
            long = ", long" if entry.cost_s > _LONG else ""
            progress(
                f"table {number}/{len(wanted)}  {entry.name} {entry.title}, "
                f"about {entry.cost_s:g} s{long}"
            )
            compute(entry, records, progress)
            rows[entry.name] = rows_of(entry, records)
            found = {name: records[run] for name, run in entry.runs.items()}
            if entry.picture is not None and not any("ended" in one for one in found.values()):
                (out / "reproduced").mkdir(exist_ok=True)
                path = _picture(entry.name)
                pictures[path] = entry.picture.draw(found)
                write_figure(out / path, pictures[path])
            text = _text(entry, rows[entry.name], pictures)
            show("\n".join([*_runs_text(entry), text]))
            # written after each table: stopping a later one loses nothing already computed
            done = [own for own in order if own.name in rows]
            content["rows"] = [row for own in done for row in rows[own.name]]
            write_json(out / "reproduce.json", content)
            texts = [_text(own, rows[own.name], pictures) for own in done]
            write_text(out / "reproduce.md", _markdown(content, done, texts))
            # for readers without the command's output, with the decks
            texts = [
                text.replace("\n", "".join(f"\n\n`{line}`" for line in _runs_text(own)) + "\n", 1)
                for own, text in zip(done, texts, strict=True)
            ]
            footer = Markup("All numbers: <code>reproduce.json</code>")
            page = page_of_markdown(_markdown(content, done, texts), pictures, footer)
            write_text(out / "reproduce.html", page)
    return content


def compute(entry: Table, records: dict[Run, Record], progress: ProgressCallback) -> None:
    """Run what a table needs and `records` lacks, and record the processor time of each run."""
    for run in entry.runs.values():
        if run not in records:
            records[run] = _record(run, progress)


def _picture(name: str) -> str:
    """File name of a table's picture in the folder of the results."""
    return f"reproduced/{name}.png"


def rows_of(entry: Table, records: Mapping[Run, Record]) -> list[dict[str, Any]]:
    """Rows of a table whose runs are finished; see `reproduce`."""
    return [_row(entry, row, records) for row in entry.rows]


def _record(run: Run, progress: ProgressCallback) -> Record:
    """Record of a run, and its processor time."""
    before = _spent()
    try:
        record = dict(RUNS[run.kind](run, progress))
    except MyorkError as reason:
        record = {"ended": f"{type(reason).__name__}: {reason}"}
    return record | {"cpu_s": _spent() - before}


def _spent() -> float:
    """Processor time of this process and of its finished child processes [s]."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in both)


def _row(entry: Table, row: Row, records: Mapping[Run, Record]) -> dict[str, Any]:
    """A row: published number and ours."""
    names, keys = row.quantity[::2], row.quantity[1::2]
    read = [records[entry.runs[name]] for name in names]
    values = [entry_of(record, key) for record, key in zip(read, keys, strict=True)]
    ended = next((record["ended"] for record in read if "ended" in record), None)
    ours = None
    if ended is None:
        ours = float(values[0] if len(values) == 1 else values[0] / values[1])
    ratio = None if ours is None or row.published is None else ours / row.published
    unique = {id(record): record for record in read}.values()
    return {
        "table": entry.name,
        "row": row.name,
        "published": row.published,
        "ours": ours,
        "ratio": ratio,
        "cpu_s": sum(record["cpu_s"] for record in unique),
        "far": row.published is not None and (ratio is None or abs(ratio - 1.0) > FAR),
        "note": row.note or entry.note,
        **({} if ended is None else {"ended": ended}),
    }


# ---- what is written -----------------------------------------------------------------------------


def _runs_text(entry: Table) -> list[str]:
    """Decks with their overrides, one line each."""
    lines = []
    for run in entry.runs.values():
        place = f"inputs/{run.deck}.toml" if run.deck.islower() else f"phantoms.{run.deck}"
        more = f", {run.more}" if isinstance(run.more, str) else ""
        lines.append(
            " ".join([place + more, *(f"--set {shlex.quote(word)}" for word in run.overrides)])
        )
    return list(dict.fromkeys(lines))


def _notes(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Notes of the rows as sentences, those of large deviations first, each once."""
    ordered = sorted(rows, key=lambda row: not row["far"])
    notes = dict.fromkeys(row["note"] for row in ordered if row["note"])
    ended = dict.fromkeys(row["ended"] for row in rows if "ended" in row)
    texts = [*(f"no number: {text}" for text in ended), *notes]
    return [f"{text[0].upper()}{text[1:].removesuffix('.')}." for text in texts]


def _number(value: float | None, digits: int = 4) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


def _text(entry: Table, rows: Sequence[Mapping[str, Any]], pictures: Mapping[str, Figure]) -> str:
    """A table as written to `reproduce.md`."""
    beside = {row.name: row.beside for row in entry.rows if row.beside}
    more = {beside[row["row"]]: _number(row["ours"]) for row in rows if row["row"] in beside}
    columns = list(dict.fromkeys(column for _, column in more))
    lines = [["row", "published", "ours", "ratio", "CPU [s]", *columns]]
    lines += [
        [
            row["row"],
            _number(row["published"]),
            _number(row["ours"]),
            _number(row["ratio"], 3) + (r" \*" if row["far"] else ""),
            _number(row["cpu_s"], 3),
            *(more.get((row["row"], column), "") for column in columns),
        ]
        for row in rows
        if row["row"] not in beside
    ]
    name = entry.name if entry.name.startswith("figure") else f"table {entry.name}"
    heading = f"## {name.replace('-', ' ').capitalize()}: {entry.title}"
    text = [heading, "", *table_lines(lines)]
    if entry.picture is not None and _picture(entry.name) in pictures:
        text += ["", f"![{entry.picture.caption}]({_picture(entry.name)})"]
    return "\n".join([*text, "", *(f"{note}\n" for note in _notes(rows))])


def _markdown(content: Mapping[str, Any], done: Sequence[Table], texts: Sequence[str]) -> str:
    """The page `docs/reproduced.md`."""
    names = [entry.name for entry in done]
    far = [row["row"] for row in content["rows"] if row["far"]]
    times = sum(name.endswith(("[s]", "[min]")) for name in far)
    about = (
        f"Written by `myork reproduce {' '.join(names) if len(names) < 8 else 'all'}` "
        f"(version {content['version']}, {content['date'][:10]}, {content['processor']}, one "
        f"thread): {len(content['rows'])} numbers of {len(done)} tables and figures. {len(far)} of "
        f"them are more than {100 * FAR:.0f} % off (*), with the reason below the table; {times} "
        "of these are times of another machine. CPU seconds are of the runs that a row reads. The "
        "command prints the decks with their overrides, `myork reproduce --list` the costs, and "
        "figures without numbers."
    )
    return "\n".join(["# The dissertation's tables and figures", "", about, "", *texts])


def entry_of(case: Mapping[str, Any], key: str) -> Any:
    """Entry of nested mappings and lists by a key such as `probes.stress`; None if missing."""
    value: Any = case
    for part in key.split("."):
        if isinstance(value, Sequence) and part.isdigit():
            value = value[int(part)] if int(part) < len(value) else None
        else:
            value = value.get(part) if isinstance(value, Mapping) else None
    return value
