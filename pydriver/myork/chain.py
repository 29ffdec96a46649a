"""All stations of a deck one after the other: images, points, solution, report."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from myork.console import ProgressCallback, silent
from myork.core.deck import load_deck
from myork.errors import ConvergenceError, RefusedError
from myork.summary import asked


def segment_and_draw(
    deck: str | Path, out: str | Path, *, progress: ProgressCallback = silent, **settings: Any
) -> dict[str, Any]:
    """Run `segment` and draw its labels over the image.

    Parameters and return value are those of `myork.segment`.
    """
    from myork.report.image_figures import draw_labels
    from myork.stations.segment import segment

    found = segment(deck, out, progress=progress, **settings)
    progress(f"labels on the image: {', '.join(map(str, draw_labels(Path(out))))}")
    return found


def run_chain(
    deck: str | Path,
    out: str | Path,
    *,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
    verbosity: int = 0,
    error: bool = True,
) -> Path:
    """Run everything that a deck asks for, from its images to a report.

    - `overrides`: `"table.key=value"` each
    - `verbosity`, `error`: for the solution, as in `run_deck`
    - returns the report
    - raises RefusedError, ConvergenceError: as `run_deck`, after a report of what exists is
      written
    """
    from myork.report import make_report
    from myork.stations.build import build
    from myork.stations.explain import stations_of
    from myork.stations.solve import run_deck

    station: dict[str, Callable[..., Any]] = {
        "segment": segment_and_draw, "build": build, "solve": run_deck,
    }  # fmt: skip
    with asked(Path(out)):
        names = stations_of(load_deck(deck, overrides))
    ended = None
    for number, name in enumerate(names, start=1):
        progress(f"station {number}/{len(names) + 1}  {name}")
        more = {"verbosity": verbosity, "error": error} if name == "solve" else {}
        try:
            # a solve itself records why it stopped
            with nullcontext() if name == "solve" else asked(Path(out)):
                station[name](
                    deck, out, overrides=overrides, threads=threads, progress=progress, **more
                )
        except (RefusedError, ConvergenceError) as reason:
            ended = reason
    progress(f"station {len(names) + 1}/{len(names) + 1}  report")
    page = make_report(Path(out))
    if ended is not None:
        progress(f"report: {page}")
        raise ended
    return page
