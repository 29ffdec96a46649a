"""A shared library that is missing: the message says which one and what to install."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import myork
from myork import run_deck
from myork.errors import InstallationError
from myork.libraries import cure_of
from myork.stations import solve

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
    with pytest.raises(
        InstallationError, match=r"libgomp\.so\.9 is not .*apt-get install libgomp1"
    ):
        run_deck(inputs / "shear_2d.toml", tmp_path / "out")


def test_extension(inputs: Path, tmp_path: Path) -> None:
    """`import myork.core` names the library; the command ends with status 3."""
    package = Path(myork.__file__).parent
    ignored = shutil.ignore_patterns("inputs", "__pycache__", "_core*.so")
    shutil.copytree(package, tmp_path / "myork", ignore=ignored)
    for core in package.glob("_core*.so"):
        broken(core, tmp_path / "myork" / core.name)
    done = subprocess.run(
        [sys.executable, "-m", "myork", "explain", str(inputs / "shear_2d.toml")],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 3
    assert "libgomp.so.9 is not on this machine" in done.stderr
    assert "apt-get install libgomp1" in done.stderr and "Traceback" not in done.stderr


def test_other_complaints() -> None:
    assert "sh setup.sh" in cure_of("undefined symbol: dgemm_")
    said = cure_of(
        "error while loading shared libraries: libfoo-2.so.1: cannot open shared object file"
    )
    assert "libfoo-2.so.1 is not on this machine" in said and "the package that holds" in said
