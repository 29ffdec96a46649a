"""The command line: help, exit status, messages, libraries that are missing.

Where only the hand-over to the executable matters, a small script stands in for `myork-solve`.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import myork
from myork import _core, cli, run_deck
from myork.bench import BENCHES
from myork.errors import InstallationError, cure_of
from myork.stations import solve
from tests.scenes import refuses

COMMANDS = ("demo", "segment", "build", "solve", "run", "rom", "report", "explain")
#: Where a package lies below its prefix
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
    """Exit status of a command; argparse leaves by SystemExit."""
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


#: Another version, which no machine has
ASKED, ABSENT = b"libgomp.so.1", b"libgomp.so.9"


def broken(source: Path, copy: Path) -> Path:
    """A compiled file that asks for a library of another version."""
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
