"""Both programs, whole: the same refusals, answers that are none, a clean end on Ctrl-C."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from myork.core.deck import text_of_tables
from myork.results import Results
from myork.stations.solve import find_executable
from myork.summary import read_summary
from tests.scenes import box, execute, held, probes, scene

#: Longest wait for a solution of a second or two; a failure, not a measurement [s]
PATIENCE = 300

#: The programs, and how each calls the folder of the results
OUT = {"myork": "--out", "myork-solve": "-o"}

DECK = scene(
    "auto", box(3, 3, 3), title="Stretched cube",
    material=[{"name": "rubber", "model": "polynomial", "A10": 37.3, "K": 1e4}],
    boundary=[held("z0"), {"set": "z1", "u_z": 0.2}], load={"steps": 2},
    probe=probes("pull force_z z1"),
)  # fmt: skip


def command(program: str) -> list[str]:
    """Words that start a program; `myork` is told to solve."""
    if program == "myork":
        return [sys.executable, "-m", "myork", "solve"]
    return [str(find_executable())]


def run(program: str, *words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*command(program), *map(str, words)],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE,
    )  # fmt: skip


@pytest.mark.parametrize(("out", "threads"), [("-o", "-t"), ("--out", "--threads")])
def test_short_and_long_options_of_the_executable(out: str, threads: str, tmp_path: Path) -> None:
    """The deck has no title, so that the summary has the name of its file."""
    deck, folder = tmp_path / "pulled cube.toml", tmp_path / "results"
    lines = text_of_tables(DECK).split("\n")
    deck.write_text("\n".join(line for line in lines if not line.startswith("title")), "utf-8")
    done = run("myork-solve", deck, out, folder, threads, "2", "-q", "--no-error")
    assert done.returncode == 0 and done.stdout == "", done.stderr
    assert read_summary(folder)["threads"] == 2
    assert read_summary(folder)["title"] == "pulled cube"


@pytest.mark.parametrize("program", OUT)
def test_numbers_not_finite_are_no_answer(program: str, inputs: Path, tmp_path: Path) -> None:
    """Squares of 1e300 overflow: exit 1 and the reason, in the summary too."""
    words = (inputs / "cantilever.toml", OUT[program], tmp_path)
    done = run(program, *words, "--set", "boundary.x1.traction=[0,1e300]")
    assert done.returncode == 1 and "NaN or infinite" in done.stderr, done.stdout + done.stderr
    summary = read_summary(tmp_path)
    assert summary["converged"] is False
    assert any("NaN or infinite" in line for line in summary["warnings"])


#: What stations before a solve say, with all that JSON allows
EARLIER = {
    "segmentation": {
        "labels": {'gastrocnemius "médial"': {"pixels": 12, "volume": 1.5e-7}, "\\\n\u0001": {}},
        "iterations": 3,
        "energy": [-1.25e300, 0.0, None, []],
    },
    "tissue": {"labels": {}, "found": [True, False, [[1, -2], {"a": {"b": [{}]}}]]},
    "model": {"warnings": ["die Muskeln berühren sich \U0001f9b5", ""], "volume": {"muscle": 1e22}},
    "resampled": [{"file": "mask.nii", "how": "nearest", "shift": 0.5, "station": "segment"}],
}


def solve_over(text: str, inputs: Path, folder: Path) -> tuple[dict[str, Any], str]:
    """Solve into a folder with a summary: the new one, and what is said."""
    (folder / "summary.json").write_text(text, encoding="utf-8")
    sizes = ("load.steps=1", "geometry.source=[3,3,3]", "geometry.collocation=[5,5,5]")
    summary, done = execute(inputs / "shear_3d.toml", folder, "--no-error", sets=sizes)
    assert done.returncode == 0 and len(summary["steps"]) == 1, done.stderr
    return summary, done.stdout


@pytest.mark.parametrize("ascii", [True, False])
@pytest.mark.parametrize("indent", [1, 2])
def test_the_executable_keeps_earlier_stations(inputs, tmp_path, ascii, indent):
    """Those that hold whatever is solved; what told of another solution goes."""
    stale = {"rom": {"models": []}, "exact": {}, "errors": {"L2": 1}, "message": "did not converge"}
    found = {"title": "before", **EARLIER, **stale, "steps": []}
    text = json.dumps(found, ensure_ascii=ascii, indent=indent)
    summary, _ = solve_over(text, inputs, tmp_path)
    assert {key: summary[key] for key in EARLIER} == EARLIER
    assert summary["title"] != "before"
    assert not {"rom", "errors", "message"} & set(summary)
    assert summary["exact"]


@pytest.mark.parametrize("damage", [
    "", "[1, 2]", "{", '{"model": {"a": 1}', '{"model": 1}', '{\n "model": 1',
    '{\n "model": 1\n} x', '{\n "model"\n}', '{\n model: 1\n}', '{\n "model": {\n "a": 1\n }\n}',
])  # fmt: skip
def test_a_damaged_summary_is_dropped(inputs: Path, tmp_path: Path, damage: str) -> None:
    summary, said = solve_over(damage, inputs, tmp_path)
    assert "the earlier summary.json is damaged" in said and "model" not in summary


@pytest.mark.slow
@pytest.mark.parametrize("program", OUT)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_keeps_what_converged(program, number, inputs: Path, tmp_path: Path) -> None:
    """A thousand steps, stopped after the first: what converged is on disk and readable."""
    words = [inputs / "shear_3d.toml", OUT[program], tmp_path, "--set", "load.steps=1000"]
    process = subprocess.Popen(
        [*command(program), *map(str, words)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    next(line for line in process.stdout if line.startswith("step"))
    process.send_signal(number)
    _, message = process.communicate(timeout=PATIENCE)
    summary = read_summary(tmp_path)
    assert process.returncode == 1 and summary["converged"] is False
    line = r"stopped on the way to load (\S+); last converged load (\S+) \("
    attempted = re.search(line, message)
    assert attempted, message
    assert float(attempted[1]) > float(attempted[2]) == pytest.approx(summary["steps"][-1]["load"])
    assert 1 <= len(summary["steps"]) < 1000
    with Results(tmp_path) as results:
        assert results.nstep == 1 + len(summary["steps"])
