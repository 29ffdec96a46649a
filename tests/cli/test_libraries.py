"""A shared library that is missing: the message says which one and what to install."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import myork
from myork import _core, run_deck
from myork.errors import InstallationError, cure_of
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
    with pytest.raises(InstallationError, match=r"libgomp\.so\.9 is not .*sh setup\.sh"):
        run_deck(inputs / "shear_2d.toml", tmp_path / "out")


def test_extension(inputs: Path, tmp_path: Path) -> None:
    """`import myork.core` names the library; the command ends with status 3."""
    package = Path(myork.__file__).parent
    ignored = shutil.ignore_patterns("inputs", "__pycache__", "_core*.so")
    shutil.copytree(package, tmp_path / "myork", ignore=ignored)
    core = Path(_core.__file__)
    broken(core, tmp_path / "myork" / core.name)
    done = subprocess.run(
        # an editable installation would be found before the path
        [sys.executable, "-S", "-m", "myork", "explain", str(inputs / "shear_2d.toml")],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 3
    assert "libgomp.so.9 is not on this machine" in done.stderr
    assert "Traceback" not in done.stderr


def test_other_complaints() -> None:
    assert "sh setup.sh" in cure_of("undefined symbol: dgemm_")
    said = cure_of("loading shared libraries: libfoo-2.so.1: cannot open shared object file")
    assert "libfoo-2.so.1 is not on this machine" in said
