"""Preview of a deck: what it will compute and the cost, before any computation."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from myork.console import ProgressCallback, say
from myork.core.cloud import model_path
from myork.core.deck import load_deck, step_count
from myork.errors import FileError
from myork.imaging.io import read_image
from myork.stations.solve import refuse_other_model, run_executable, set_options


def explain_deck(
    deck: str | Path,
    *,
    out: str | Path | None = None,
    overrides: Sequence[str] = (),
    progress: ProgressCallback = say,
) -> None:
    """Describe what a deck will model: images, sizes, memory and cost; refuse what does not fit.

    - `out`: folder in which the model of the deck is looked for first
    - `progress`: called with every line of the explanation
    """
    values = load_deck(deck, overrides)
    folder = Path("out", Path(deck).stem) if out is None else Path(out)
    try:
        model_path(values, Path(values["folder"]), folder)
    except (FileError, KeyError):
        # its points do not exist yet, or are not wanted
        for line in _stations(values):
            progress(line)
        return
    refuse_other_model(values, folder, overrides)
    options = ["--explain"] if out is None else ["--explain", "-o", str(out)]
    more = _states(deck, values, overrides)

    def say(line: str) -> None:
        if line.startswith("  solver "):
            for one in more:
                progress(one)
        progress(line)

    run_executable(deck, [*options, *set_options(overrides)], say)


def _states(deck: str | Path, values: Mapping[str, Any], overrides: Sequence[str]) -> list[str]:
    """The time steps of a motion, and the states from which `myork rom` makes modes."""
    lines = []
    if "dynamics" in values:
        motion = values["dynamics"]
        written = f", every {motion['every']}th is written" if motion["every"] > 1 else ""
        lines.append(
            f"  motion        {step_count(values)} time steps of {motion['time_step']:g} to time "
            f"{motion['end_time']:g}{written}"
        )
    elif "linear" in values:
        return lines
    text = "\n".join([Path(deck).read_text(encoding="utf-8"), *overrides])
    if re.search(r"^\s*(\[\s*rom\s*\]|rom\.)", text, re.MULTILINE):
        table, count = values["rom"], step_count(values)
        modes = ", ".join(str(r) for r in table["modes"])
        few = " (more modes are refused)" if count < max(table["modes"]) else ""
        lines.append(f"  rom           modes {modes} of {count} states{few}: `myork rom`")
    return lines


def stations_of(values: Mapping[str, Any]) -> list[str]:
    """Commands that a deck needs before its report, in order.

    - `values`: tables of the deck with defaults, from `load_deck`
    """
    geometry = values.get("geometry")
    solved = ["solve"] if geometry is not None else []
    if geometry is not None and geometry["kind"] != "model":
        return solved
    made = "labels" in values["build"] or "surface" in values["build"]
    return [*([] if made else ["segment"]), "build", *solved]


def _stations(values: Mapping[str, Any]) -> list[str]:
    """Description of the stations before the solve."""
    build = values["build"]
    lines = [values["title"]]
    if "surface" in build:
        lines.append(
            f"  surface       {build['surface']}, cut into voxels of {_by(build['voxel'])} mm"
        )
    elif "labels" in build:
        lines.append(f"  labels        {build['labels']}")
    else:
        lines += _images(values)
    block, stride = build["collocation_stride"], build["source_stride"]
    lines.append(
        f"  build         a collocation point for {_by(block)} voxels, a source point for "
        f"{_by(stride)}"
    )
    if "geometry" in values:
        lines.append(
            f"  solve         method {values['scene']['method']}, {len(values['material'])} "
            f"material(s); sizes and cost once model.h5 is built: explain again then"
        )
    lines.append(f"  commands      {', '.join(f'myork {name}' for name in stations_of(values))}")
    return lines


def _images(values: Mapping[str, Any]) -> list[str]:
    """The images and how they are segmented."""
    image, phantom = values["image"], values["phantom"]
    echoes = values["dixon"].get("magnitude", [])
    named = image.get("anatomy") or next(iter(echoes), None)
    if named:
        path = Path(values["folder"]) / named
        anatomy = read_image(path)
        size, spacing = anatomy.data.shape[:3], [round(float(s), 4) for s in anatomy.spacing]
        lines = [f"  image         {path.name}: {_by(size)} voxels of {_by(spacing)} mm"]
        if echoes:
            lines.append(f"  channels      water and fat of {len(echoes)} echoes")
        beside = [*([image["fat"]] if "fat" in image else []), *image["channels"]]
        if beside:
            lines.append(f"  channels      {', '.join(beside)}")
        if image.get("tensor") or image.get("dwi"):
            lines.append(f"  diffusion     {image.get('tensor') or image.get('dwi')}")
    else:
        lines = [
            f"  image         none given: a phantom calf of {_by(phantom['size'])} voxels of "
            f"{_by(phantom['spacing'])} mm with its diffusion tensors"
        ]
    what = f"{len(values['muscle'])} muscles" if values["muscle"] else "muscle"
    lines.append(
        f"  segment       {what}: {image['regions']} regions by level sets, bias by "
        f"{values['bias']['method']}"
    )
    return lines


def _by(values: Sequence[float]) -> str:
    return " x ".join(f"{value:g}" for value in values)
