"""The command line: help, exit status, messages, missing libraries.

Where only the call of the executable matters, a small script replaces `myork-solve`.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import myork
from myork import _core, cli, run_deck
from myork.bench import BENCHES
from myork.core.deck import text_of_tables
from myork.errors import InstallationError, cure_of
from myork.results import Results
from myork.stations import solve
from myork.stations.solve import find_executable
from myork.summary import read_summary
from tests.scenes import execute, refuses, strip

COMMANDS = ("demo", "segment", "build", "solve", "run", "rom", "report", "explain")
#: Location of a package below its prefix
PACKAGE_PLACE = "prefix/lib/python3/site-packages/myork/stations/solve.py"

Install = Callable[[str], Path]


@pytest.fixture
def no_solver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A Python without the executable: not beside it, not in the prefix, not on the PATH."""
    folder = tmp_path / "venv" / "bin"
    folder.mkdir(parents=True)
    monkeypatch.setattr(sys, "executable", str(folder / "python3"))
    monkeypatch.setattr(solve, "__file__", str(tmp_path / PACKAGE_PLACE))
    monkeypatch.setenv("PATH", str(folder / "nothing"))
    return folder


@pytest.fixture
def solver(no_solver: Path) -> Install:
    real_python = os.path.realpath("/proc/self/exe")

    def install(script: str) -> Path:
        path = no_solver / "myork-solve"
        path.write_text(f"#!{real_python} -S\nimport os, signal, sys, time\n{script}")
        path.chmod(0o755)
        return path

    return install


@pytest.fixture
def deck(tmp_path: Path) -> Path:
    path = tmp_path / "case.toml"
    path.write_text('title = "nothing reads this"\n')
    return path


def status_of(*words: object) -> int:
    """Exit status of a command; argparse exits by SystemExit."""
    try:
        return cli.main([str(word) for word in words])
    except SystemExit as leaving:
        assert isinstance(leaving.code, int)
        return leaving.code


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of(command, "--help") == 0
    text = capsys.readouterr().out
    for part in ("--out", "--threads", "--quiet", "--verbose", f"  myork {command}", "exit status"):
        assert part in text


def test_what_help_and_version_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("--help") == 0
    text = capsys.readouterr().out
    assert [command for command in COMMANDS if f"\n    {command} " not in text] == []
    assert status_of("bench", "--help") == 0
    assert set(BENCHES) <= set(re.findall(r"\w+", capsys.readouterr().out))
    assert status_of("--version") == 0
    assert capsys.readouterr().out == f"myork {myork.__version__}\n"


def test_help_loads_no_numerics() -> None:
    code = (
        "import sys, myork.cli\n"
        "try: myork.cli.main(['solve', '--help'])\n"
        "except SystemExit: pass\n"
        "print('loaded:', *{'numpy', 'rich', 'h5py', 'matplotlib', 'nibabel'} & set(sys.modules))"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).endswith("loaded:\n")


@pytest.mark.parametrize(("words", "part"), [
    ((), "COMMAND"),
    (("solv", "case.toml"), "invalid choice: 'solv'"),
    (("solve",), "DECK"),
    (("solve", "case.toml", "--set", "load.steps"), "KEY=VALUE"),
    (("solve", "case.toml", "--set", "=3"), "KEY=VALUE"),
    (("solve", "case.toml", "--set", "load.steps="), "KEY=VALUE"),
    (("solve", "case.toml", "--threads", "0"), "between 1 and 1024"),
    (("solve", "case.toml", "--threads", "two"), "between 1 and 1024"),
    (("solve", "case.toml", "-q", "-v"), "not allowed with"),
    (("solve", "case.toml", "--speed", "3"), "--speed"),
    (("explain", "case.toml", "--out", ""), "the name of a folder"),
    (("explain", "case.toml", "--threads", "100000"), "between 1 and 1024"),
])  # fmt: skip
def test_wrong_arguments(words, part, capsys):
    assert status_of(*words) == 2
    captured = capsys.readouterr()
    assert part in captured.err and captured.out == ""


@pytest.mark.usefixtures("no_solver")
@pytest.mark.parametrize("verbose", [(), ("-v",)])
def test_missing_executable(deck, tmp_path, capsys, verbose):
    assert status_of("solve", deck, "--out", tmp_path / "out", *verbose) == 3
    message = capsys.readouterr().err
    assert "myork-solve is missing" in message and "setup.sh" in message
    assert ("Traceback" in message) == bool(verbose)


def test_executable_of_the_package_comes_first(solver: Install, tmp_path: Path) -> None:
    """A package built beside an older installation runs its own executable."""
    beside = solver("")
    assert solve.find_executable() == beside
    own = tmp_path / "prefix" / "bin" / "myork-solve"
    own.parent.mkdir(parents=True)
    own.symlink_to(beside)
    assert solve.find_executable() == own


def test_arguments_reach_the_executable(solver, deck, tmp_path, capsys):
    out = tmp_path / "deep" / "out"
    solver(
        "print(*sys.argv[1:], sep='|')\n"
        "print(os.environ['OMP_WAIT_POLICY'])\n"
        "open(os.path.join(sys.argv[3], 'summary.json'), 'w').write('{\"steps\": []}')\n"
    )
    words = ["--set", "material.fat.K=5e3", "--set", "load.steps=3", "--solver", "refined"]
    assert status_of("solve", deck, "--out", out, "--threads", 2, *words, "--method", "rkcm") == 0
    sets = ("material.fat.K=5e3", "load.steps=3", "scene.method=rkcm", "solver.linear=refined")
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["|".join([f"{deck}|-o|{out}|-t|2", *(f"--set|{k}" for k in sets)]), "passive"]


@pytest.mark.parametrize(("script", "status", "part"), [
    ("sys.exit('load step 3: no convergence, see run.log')", 1, "load step 3"),
    ("print('case.toml:1: key: unknown', file=sys.stderr); sys.exit(2)", 2, "case.toml:1: key"),
    ("print('libhdf5.so: not found', file=sys.stderr); sys.exit(127)", 3, "libhdf5.so"),
    ("os.kill(os.getpid(), signal.SIGSEGV)", 3, "SIGSEGV"),
    ("os.kill(os.getpid(), signal.SIGKILL)", 1, "memory"),
    ("pass", 3, "summary.json"),
])  # fmt: skip
def test_exit_status_of_the_executable(solver, deck, tmp_path, capsys, script, status, part):
    solver(script)
    assert status_of("solve", deck, "--out", tmp_path / "out") == status
    message = capsys.readouterr().err
    assert part in message and message.startswith("myork: ") and "Traceback" not in message


def test_quiet_shows_no_progress(solver, deck, tmp_path, capsys):
    solver("print('step  1/2'); print('refused', file=sys.stderr); sys.exit(2)")
    assert status_of("solve", deck, "--out", tmp_path / "out", "-q") == 2
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "myork: refused\n")


#: A version that no machine has
ASKED, ABSENT = b"libgomp.so.1", b"libgomp.so.9"


def broken(source: Path, copy: Path) -> Path:
    """A compiled file that requires another version of a library."""
    data = source.read_bytes()
    assert ASKED in data
    copy.write_bytes(data.replace(ASKED, ABSENT))
    copy.chmod(0o755)
    return copy


def test_executable(inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = broken(solve.find_executable(), tmp_path / "myork-solve")
    monkeypatch.setattr(solve, "find_executable", lambda: program)
    said, deck = r"libgomp\.so\.9 is not .*sh setup\.sh", inputs / "shear_2d.toml"
    refuses(said, run_deck, deck, tmp_path / "out", kind=InstallationError)
    assert "sh setup.sh" in cure_of("undefined symbol: dgemm_")
    said = cure_of("loading shared libraries: libfoo-2.so.1: cannot open shared object file")
    assert "libfoo-2.so.1 is not on this machine" in said


def test_extension(inputs: Path, tmp_path: Path) -> None:
    ignored = shutil.ignore_patterns("inputs", "__pycache__", "_core*.so")
    shutil.copytree(Path(myork.__file__).parent, tmp_path / "myork", ignore=ignored)
    core = Path(_core.__file__)
    broken(core, tmp_path / "myork" / core.name)
    done = subprocess.run(
        # an editable installation would be found before the path
        [sys.executable, "-S", "-m", "myork", "explain", str(inputs / "shear_2d.toml")],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 3 and "Traceback" not in done.stderr
    assert "libgomp.so.9 is not on this machine" in done.stderr


# ---- both programs: invalid answers, a clean stop on Ctrl-C --------------------------------------


#: Longest wait for a solution of a second or two; a failure, not a measurement [s]
PATIENCE = 300

#: The programs, and the option of each for the folder of the results
OUT = {"myork": "--out", "myork-solve": "-o"}


def command(program: str) -> list[str]:
    """Words that start a program; `myork` needs its command `solve`."""
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
    deck, folder = tmp_path / "pulled strip.toml", tmp_path / "results"
    lines = text_of_tables(strip(5, 3)).split("\n")
    deck.write_text("\n".join(line for line in lines if not line.startswith("title")), "utf-8")
    done = run("myork-solve", deck, out, folder, threads, "2", "-q", "--no-error")
    assert done.returncode == 0 and done.stdout == "", done.stderr
    assert read_summary(folder)["threads"] == 2
    assert read_summary(folder)["title"] == "pulled strip"


@pytest.mark.parametrize("program", OUT)
def test_numbers_not_finite_are_no_answer(program: str, inputs: Path, tmp_path: Path) -> None:
    """Squares of 1e300 overflow: exit 1 and the reason, in the summary too."""
    words = (inputs / "cantilever.toml", OUT[program], tmp_path)
    done = run(program, *words, "--set", "boundary.x1.traction=[0,1e300]")
    assert done.returncode == 1 and "NaN or infinite" in done.stderr, done.stdout + done.stderr
    summary = read_summary(tmp_path)
    assert summary["converged"] is False
    assert any("NaN or infinite" in line for line in summary["warnings"])


#: Entries of stations before a solve, with everything that JSON allows
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
    """Solve into a folder with a summary; returns the new summary and the output."""
    (folder / "summary.json").write_text(text, encoding="utf-8")
    sizes = ("load.steps=1", "geometry.source=[3,3,3]", "geometry.collocation=[5,5,5]")
    summary, done = execute(inputs / "shear_3d.toml", folder, "--no-error", sets=sizes)
    assert done.returncode == 0 and len(summary["steps"]) == 1, done.stderr
    return summary, done.stdout


@pytest.mark.parametrize("ascii", [True, False])
@pytest.mark.parametrize("indent", [1, 2])
def test_the_executable_keeps_earlier_stations(inputs, tmp_path, ascii, indent):
    """Entries that hold for any solve are kept; those about another solution, or a model where the
    body is a box, are removed."""
    stale = {"rom": {"models": []}, "exact": {}, "errors": {"L2": 1}, "message": "did not converge"}
    found = {"title": "before", **EARLIER, **stale, "steps": []}
    text = json.dumps(found, ensure_ascii=ascii, indent=indent)
    summary, _ = solve_over(text, inputs, tmp_path)
    kept = {key: entry for key, entry in EARLIER.items() if key != "model"}
    assert {key: summary[key] for key in kept} == kept
    assert summary["title"] != "before"
    assert not {"model", "rom", "errors", "message"} & set(summary)
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
