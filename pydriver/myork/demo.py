"""The whole workflow in one command: phantom images to muscle force, reduced model and pages."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from myork.console import ProgressCallback, silent
from myork.errors import RefusedError
from myork.files import INPUTS, write_json, write_text
from myork.summary import with_bar

_DECK = INPUTS / "mg_muscle.toml"
#: Files of the reduced model, in addition to those that the stations write
_MODEL, _PAGE = "mg_muscle.rom.h5", "mg_muscle.html"
#: The fibers are shorter than their optimal length. At that length, as in the deck, activation
#: stretches fibers at the rim of the fixed planes to 1.25 and more. Active stress decreases with
#: stretch there, and the material loses ellipticity from an activation of 0.18 on.
_OVERRIDES = (
    "material.muscle.lambda_o=1.4",
    "load.steps=3",
    # with voxels twice as wide, too much of the surface lacks its traction for acceptance
    "build.collocation_stride=[1,1,1]",
)
#: Free parameters of the reduced model [-], [cm]
_VARIED = {"load.activation": (0.0, 0.3), "boundary.top.u_z": (-0.3, 0.3)}
#: Full solves of its training (without early termination by a test), and of the final check
_SOLVES, _CHECKS = 24, 6


def run_demo(
    out: str | Path = "out/demo",
    *,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> str:
    """Solve the deck `mg_muscle`, train a reduced model of it, and put all results into one folder.

    - `overrides`: overrides of the deck, `"table.key=value"`
    - returns closing summary: errors of the reduced model, volume ratios and balance of forces,
      forces with their error bars, verdict, paths of the pages
    """
    from myork.core.deck import load_deck
    from myork.report import make_report
    from myork.report.frame import render
    from myork.stations.build import build
    from myork.stations.segment import segment
    from myork.stations.solve import run_deck
    from myork.summary import read_summary
    from myork.view.still import sample

    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    overrides = [*_OVERRIDES, *overrides]
    stations: dict[str, Callable[..., Any]] = {
        "phantom images to labels and fibers": segment,
        "labels to points": build,
        "full solution": run_deck,
        "reduced model": _reduced,
    }
    for number, (what, station) in enumerate(stations.items(), start=1):
        progress(f"station {number}/5  {what}")
        try:
            station(_DECK, out, overrides=overrides, threads=threads, progress=progress)
        except RefusedError as reason:
            # the answer exists, and the report shows why it is refused
            progress(str(reason))
    progress("station 5/5  pages")
    states = sample(out / _MODEL, threads=threads or 1, progress=progress)
    write_text(out / _PAGE, render("view.html", **states))
    report = make_report(out)
    summary = read_summary(out)
    verdict, last, units = summary["verdict"], summary["steps"][-1], summary["probe_units"]
    probes = load_deck(_DECK, overrides)["probe"]
    forces = (own["name"] for own in probes if own["quantity"].startswith("force"))
    return "\n".join(
        [
            states["about"]["describe"],
            f"J {last['min_J']:.3g} to {last['max_J']:.3g}, force imbalance "
            f"{summary['force_imbalance']:.1e} of the largest",
            *(f"{k} at load {last['load']:g}: {with_bar(last, k, units[k], 4)}" for k in forces),
            "; ".join([f"verdict: {verdict['state']}", *verdict["reasons"]]),
            f"report: {report}",
            f"the muscle with sliders, in any browser: {out / _PAGE}",
        ]
    )


def _reduced(
    deck: Path,
    out: Path,
    *,
    overrides: Sequence[str],
    threads: int | None,
    progress: ProgressCallback,
) -> None:
    """Train the reduced model, and compare it with full solves outside its training."""
    from myork.rom.check import compare
    from myork.rom.train import train

    rom = train(
        deck, _VARIED, full_solves=_SOLVES, tests=0, out=out, overrides=overrides,
        threads=threads, progress=progress,
    )  # fmt: skip
    progress(f"checking against {_CHECKS} full solves not used in training")
    found = compare(rom, rom.full_model(), _CHECKS, 1, progress)
    write_json(out / "check.json", found)
    rom.set_certificate(found)
    rom.save(out / _MODEL)
