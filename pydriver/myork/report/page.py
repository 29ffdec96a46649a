"""The report page: sections for the content of a folder, as one self-contained HTML file."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from myork.errors import FileError, MyorkError
from myork.files import write_text
from myork.records import Image, Labels
from myork.report import bodies, figures, image_figures, tables
from myork.report.frame import Page, Section, figure, folded
from myork.report.numbers import fraction, number, probe_units
from myork.report.sources import RunFolder, read_folder
from myork.report.story import is_phantom, story
from myork.report.sweep_page import SWEEP_FILE, read_sweep, sweep_page
from myork.summary import failures

#: Probes that are compared with those of reduced models
_MOST = 3


def make_report(folder: str | Path) -> Path:
    """Write `report.html` from the content of an output folder.

    - `folder`: output folder of `solve`, `rom`, `segment`, `demo` or `sweep`
    - returns the page; figures are embedded, and nothing is loaded from elsewhere
    """
    path = Path(folder)
    swept = (path / SWEEP_FILE).is_file()
    # unreadable files are refused there
    content: Any = read_sweep(path) if swept else read_folder(path)
    try:
        text = (sweep_page(content) if swept else _page(content)).text()
    except MyorkError:
        raise
    except Exception as reason:
        raise FileError(
            f"{path}: summary.json or another file is damaged, or the report itself failed: "
            f"{reason!r}; run the command again"
        ) from reason
    write_text(path / "report.html", text)
    return path / "report.html"


def _page(folder: RunFolder) -> Page:
    """The whole page of a run."""
    summary = folder.summary
    return Page(
        title=summary.get("title") or folder.path.resolve().name,
        sections=(
            Section("images", "From the image to the labels", _images(folder)),
            Section("deformation", "Deformation", _deformation(folder)),
            Section("planes", "Inside the body", _planes(folder)),
            Section("probes", "Forces and other probes", _probes(folder)),
            Section("rom", "Reduced models", _rom(folder)),
            Section("run", "The run", _run(folder)),
        ),
        badges=_badges(summary),
        story=story(folder),
        warnings=_warnings(folder),
        footer=Markup(
            "MyoRK {} · made by <code>myork report</code> from the files in\n<code>{}</code>"
        ).format(summary.get("version", ""), folder.path),
    )


#: Kind and words of each verdict
_VERDICTS = {
    "accepted": ("good", "✓ numerical error accepted"),
    "doubtful": ("unsure", "? doubtful"),
    "refused": ("bad", "✗ refused"),
}


def _badges(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Final status of the run, and whether its images were measured."""
    steps = summary.get("steps")
    if summary.get("converged"):
        verdict = summary.get("verdict", {})
        state, reasons = verdict.get("state", ""), verdict.get("reasons", ())
        if state == "accepted" and any(text.startswith("no error estimate") for text in reasons):
            yield "unsure", "accepted without an error estimate"
        else:
            yield _VERDICTS.get(state, ("unsure", "converged"))
    elif summary.get("converged") is False:
        reached = (
            f"not converged, last state at load {fraction(steps[-1].get('load'))}" if steps else ""
        )
        yield "bad", f"✗ {reached or 'no solution'}"
    if is_phantom(summary):
        yield "unsure", "phantom data"


def _warnings(folder: RunFolder) -> list[str]:
    """Warnings of the run and of the segmentation, and outdated files; reasons are in the story."""
    warnings = folder.summary.get("warnings", [])
    reasons = folder.summary.get("verdict", {}).get("reasons", [])
    refine = folder.summary.get("refine")
    return [
        *failures(folder.summary),
        *folder.summary.get("segmentation", {}).get("warnings", []),
        *(text for text in warnings if not any(text in reason for reason in reasons)),
        *([refine["reason"]] if refine and not refine["met"] else []),
    ]


def _images(folder: RunFolder) -> Iterator[Markup]:
    """Slices and scores."""
    segmentation = folder.summary.get("segmentation", {})
    units = folder.summary.get("units", {})
    if folder.labels is not None:
        image, fibers = (own if _same_grid(own, folder.labels) else None
                         for own in (folder.image, folder.fibers))  # fmt: skip
        yield figure(
            image_figures.slice_figure(folder.labels, image, fibers),
            "Slices of the image with the contour of each label and the fibers in the plane "
            "of the picture; a short stroke is a fiber that leaves the plane.",
        )
    if segmentation:
        yield tables.label_table(segmentation, units)
    if folder.tissue is not None:
        image = folder.image if _same_grid(folder.image, folder.tissue) else None
        yield figure(
            image_figures.slice_figure(folder.tissue, image, None),
            "Materials of the leg: contour of each on the image.",
        )
        yield tables.label_table(folder.summary.get("tissue", {}), units)
    if muscles := folder.summary.get("model", {}).get("muscles"):
        yield tables.muscle_table(muscles)


def _same_grid(image: Image | None, labels: Labels) -> bool:
    return image is not None and image.data.shape[:3] == labels.data.shape


def _deformation(folder: RunFolder) -> Iterator[Markup]:
    """The body in the last step."""
    deformation = folder.deformation
    if deformation is None or len(deformation.loads) < 2:
        return
    units = folder.summary.get("units", {})
    caption = Markup(
        "Load {}, activation {}: the deformed body, to scale. All steps open in ParaView: "
        "<code>results.vtkhdf</code>."
    ).format(fraction(float(deformation.loads[-1])), fraction(float(deformation.activations[-1])))
    missing = int(np.count_nonzero(np.isnan(deformation.stress)))
    if missing:
        caption = Markup(
            "{} <b>{} of {} points have no stress</b>, where the material is inverted "
            '(J ≤ 0): <span style="color:{}">this colour, or crosses in it</span>.'
        ).format(caption, missing, len(deformation.stress), bodies.NO_VALUE)
    if deformation.is_plane:
        yield figure(bodies.plane_figure(deformation, units), caption)
        return
    if not len(deformation.surface):
        caption += " Points in place of the surface, which the file does not have."
    yield figure(bodies.surface_figure(deformation, units), caption)


def _planes(folder: RunFolder) -> Iterator[Markup]:
    """Displacement, fibers and stress on three planes of a body in space."""
    deformation = folder.deformation
    if deformation is None or len(deformation.loads) < 2 or deformation.is_plane:
        return
    if len(deformation.lattice):
        tissues = list(folder.summary.get("model", {}).get("volume", {}))
        if len(tissues) != len(np.unique(deformation.label)):
            materials = folder.summary.get("deck", {}).get("material", [])
            tissues = [str(own.get("name", "")) for own in materials]
        shown = bodies.slices_figure(deformation, folder.summary.get("units", {}), tissues)
        yield figure(shown, "Planes through the middle, undeformed.")
    else:
        yield Markup("<p>No planes: the file does not say how its points are connected.</p>")


def _probes(folder: RunFolder) -> Iterator[Markup]:
    """Curves and numbers of the probes, with reference values."""
    summary = folder.summary
    units = probe_units(summary)
    steps = summary.get("steps", [])
    reference, exact = summary.get("reference", {}), summary.get("exact", {})
    if units and len(steps) > 1:
        curves = figures.probe_figure([figures.Series("", steps)], units, reference, exact)
        extra = " Open circles: reference values." if reference else ""
        if any(step.get("probe_errors") for step in steps):
            extra += " Bands: estimated errors."
        yield figure(curves, f"Probes of the deck in all converged steps.{extra}")
    if reference:
        yield tables.reference_table(reference, units)
    if exact:
        yield tables.exact_table(exact, units)
    if units and steps:
        # a single state is shown as a row of numbers, not as a dot on an axis
        values = tables.probe_table(steps, units)
        yield folded("Values in all converged steps", values) if len(steps) > 1 else values


def _rom(folder: RunFolder) -> Iterator[Markup]:
    """Comparison of full and reduced models."""
    summary = folder.summary
    rom = summary.get("rom")
    if not rom:
        return
    models = rom.get("models", [])
    caption = Markup("Decay of the orthogonal values of {} snapshots.")
    yield figure(figures.decay_figure(rom), caption.format(number(rom.get("snapshots"))))
    yield tables.rom_table(models)
    own = rom.get("full", {}).get("probes", {})
    units = {name: unit for name, unit in probe_units(summary).items() if name in own}
    if units:
        shown = figures.probe_figure(figures.rom_series(rom), dict(list(units.items())[:_MOST]))
        yield figure(shown, "Full solution (line) against the reduced models (markers).")


def _run(folder: RunFolder) -> Iterator[Markup]:
    """Method, solver, timings."""
    if "method" in folder.summary:
        yield tables.run_table(folder.summary)
