"""Output folders: one run at a time, earlier results are kept, no solve outlives its command."""

import html
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from myork.cli import main
from myork.errors import FileError
from myork.files import alone_in
from myork.report import make_report
from myork.stations.solve import find_executable
from myork.summary import WAITING, failures, read_summary, renewing, update_summary
from tests.scenes import deck_file, execute, start, strip, wait_for

#: Longest wait for something that takes a second or two; a failure, not a measurement [s]
PATIENCE = 120

#: Takes many seconds, in steps of some hundredths of a second
LONG = ("--set", "load.steps=4000")


@pytest.fixture
def deck(tmp_path: Path) -> Path:
    return deck_file(tmp_path / "deck.toml", strip(17, 5, method="rkcm", load={"steps": 4}))


def solve(deck: Path, out: Path, *words: str, **more: Any) -> subprocess.CompletedProcess[str]:
    return execute(deck, out, *words, **more)[1]


def begun(deck: Path, out: Path, *words: str) -> subprocess.Popen[str]:
    """A long solve, returned when its first step has converged."""
    run = start(deck, out, *LONG, *words)
    assert run.stdout is not None
    while "step   1/" not in (line := run.stdout.readline()):
        assert run.poll() is None, line
    return run


def files_of(out: Path) -> dict[str, bytes]:
    paths = [out / name for name in ("results.vtkhdf", "history.csv", "run.log")]
    return {path.name: path.read_bytes() for path in paths if path.is_file()}


@pytest.mark.slow
def test_a_folder_is_one_run_s(deck: Path, good: Path) -> None:
    run = begun(deck, good)
    refused = solve(deck, good)
    assert refused.returncode == 2
    assert f"in use by another run (process {run.pid})" in refused.stderr
    with pytest.raises(FileError, match=f"process {run.pid}"), alone_in(good):
        pass
    run.send_signal(signal.SIGINT)
    assert run.wait(PATIENCE) == 1
    assert solve(deck, good).returncode == 0, "the claim ends with the run"


def test_python_claims_a_folder_against_the_executable(deck: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with alone_in(out):
        refused = solve(deck, out)
    assert refused.returncode == 2
    assert f"in use by another run (process {os.getpid()})" in refused.stderr
    assert not files_of(out)


def told(out: Path, name: str = "summary.json") -> tuple[bool, str, str]:
    """The entries that a script reads first in a folder."""
    summary = json.loads((out / name).read_text())
    return summary["converged"], summary["verdict"]["state"], summary.get("message", "")


@pytest.fixture
def good(deck: Path, tmp_path: Path) -> Path:
    out = tmp_path / "out"
    assert solve(deck, out).returncode == 0
    return out


#: Requests that fail after a good solve, with exit status and message
FAILURES = {
    "not converged": (("solver.max_iterations=1", "load.max_halvings=0"), 1, "did not converge"),
    "misspelt": (("load.stps=3",), 2, "load.stps: unknown key"),
    "impossible": (("geometry.source=[2,2]",), 2, "singular moment matrix"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAILURES)
def test_the_summary_is_that_of_the_last_run(deck: Path, good: Path, name: str) -> None:
    """Refused input is no run: it leaves the folder as it was."""
    found = {"overrides": ["image.mu=0.1"]}
    update_summary(good, {"segmentation": found, "model": {"volume": {"rubber": 4.0}}})
    kept, before = (good / "summary.json").read_bytes(), files_of(good)
    settings, status, message = FAILURES[name]
    for _ in range(2):
        ended = solve(deck, good, sets=settings)
        assert ended.returncode == status and message in ended.stderr
        if status == 2:
            assert (good / "summary.json").read_bytes() == kept and files_of(good) == before
            assert not (good / WAITING).exists()
            continue
        converged, state, why = told(good)
        assert not converged and state == "refused"
        assert message in why and why in ended.stderr
        assert read_summary(good)["segmentation"] == found, "stations before it stay"
        assert (good / WAITING).read_bytes() == kept
    page = html.unescape(make_report(good).read_text())
    if status == 2:
        assert "✗ no solution" not in page and "Deformation" in page
    else:
        assert "✗ no solution" in page and f"No solution: {why}" in page
    assert solve(deck, good).returncode == 0
    assert told(good)[0] and not (good / WAITING).exists()
    assert read_summary(good)["segmentation"] == found
    assert "model" not in read_summary(good), "the deck has a box"


@pytest.mark.slow
def test_a_killed_run_leaves_no_summary_of_another(deck: Path, good: Path) -> None:
    before = files_of(good)
    run = begun(deck, good)
    why = f"the run of process {run.pid} has not ended, or was killed"
    assert told(good) == (False, "refused", why)
    run.kill()
    run.wait()
    assert told(good)[:2] == (False, "refused")
    assert files_of(good) == before and told(good, WAITING)[0]
    # nor does a deck that is refused, which leaves the journal
    assert solve(deck, good, "--set", "load.stps=3").returncode == 2
    assert (good / "results.journal").exists()
    assert files_of(good) == before and told(good, WAITING)[0]
    # killed between both renames, or removed by hand
    (good / "summary.json").unlink()
    assert solve(deck, good).returncode == 0
    assert told(good)[0] and not (good / WAITING).exists()


@pytest.mark.slow
def test_a_refused_resume_leaves_what_the_right_one_needs(deck: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = begun(deck, out)
    run.send_signal(signal.SIGINT)
    assert run.wait(PATIENCE) == 1
    unfinished = files_of(out)
    assert solve(deck, out, "--resume").returncode == 2
    assert told(out)[:2] == (False, "refused") and files_of(out) == unfinished
    assert solve(deck, out).returncode == 0
    finished = files_of(out)
    for _ in range(2):
        refused = solve(deck, out, "--resume", *LONG)
        assert refused.returncode == 2 and "a run of another deck" in refused.stderr
        assert told(out)[0] and files_of(out) == finished
    assert solve(deck, out, "--resume").returncode == 0
    assert told(out)[0] and not (out / WAITING).exists()


def test_a_start_from_the_same_folder_is_read_first(deck: Path, good: Path) -> None:
    before = files_of(good)
    assert solve(deck, good, "--start-from", f"{good}:9").returncode == 2
    assert told(good)[0] and files_of(good) == before
    assert solve(deck, good, "--start-from", f"{good}:2").returncode == 0
    assert told(good)[0] and not (good / WAITING).exists()


def test_stations_before_a_solve_set_it_aside(good: Path) -> None:
    before = files_of(good)
    with renewing(good, "rom"):
        pass
    assert files_of(good) == before
    with renewing(good, "model"):
        update_summary(good, {"model": {"volume": 1.0}})
    assert files_of(good) == before and told(good, WAITING)[0]
    assert read_summary(good) == {"model": {"volume": 1.0}}
    assert "Deformation" not in make_report(good).read_text(), "results of another model"


@pytest.mark.parametrize(
    "words", ["run --data no", "run --set load.stps=3", "solve --set load.stps=3"]
)
def test_commands_with_wrong_input_leave_the_result(deck: Path, good: Path, words: str) -> None:
    command, *rest = words.split()
    kept = (good / "summary.json").read_bytes()
    assert main([command, str(deck), "--out", str(good), "-q", *rest]) == 2
    assert (good / "summary.json").read_bytes() == kept and not (good / WAITING).exists()


@pytest.mark.parametrize("command", ["solve", "run", "myork-solve"])
@pytest.mark.parametrize("wrong", [("mu = 10", "mu = -1e99"), ("[load]", "[load")])
def test_the_summary_of_a_refused_deck(
    deck: Path, tmp_path: Path, wrong: tuple[str, str], command: str
) -> None:
    """In a new folder too: the reason and the cost."""
    out = tmp_path / "out"
    deck.write_text(deck.read_text().replace(*wrong))
    if command == "myork-solve":
        assert solve(deck, out).returncode == 2
    else:
        assert main([command, str(deck), "--out", str(out), "-q"]) == 2
    summary = read_summary(out)
    assert told(out)[:2] == (False, "refused") and summary["message"].startswith(str(deck))
    assert summary["steps"] == [] and summary["cpu_s"] > 0 and summary["version"]
    assert "None" not in make_report(out).read_text()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["myork-solve", "myork solve", "myork run -q"])
def test_no_reader_no_matter(deck: Path, tmp_path: Path, command: str) -> None:
    """Output into a pipe whose reader has gone: the run continues and its results are written."""
    out = tmp_path / "out"
    words = {
        "myork-solve": [find_executable(), deck, "-o", out, "-t", "1", "-v"],
        "myork solve": [sys.executable, "-m", "myork", "solve", deck, "--out", out],
        "myork run -q": [sys.executable, "-m", "myork", "run", deck, "--out", out, "-q"],
    }
    run = subprocess.Popen(words[command], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert run.stdout is not None and run.stderr is not None
    run.stdout.close()
    assert run.stderr.read() == b"" and run.wait(PATIENCE) == 0
    assert read_summary(out)["converged"] is True


@pytest.mark.slow
@pytest.mark.parametrize("loudness", ["-q", "-v"])
def test_a_solve_ends_with_its_command(deck: Path, tmp_path: Path, loudness: str) -> None:
    """`kill -9` of `myork solve`: the executable stops after its iteration."""
    out = tmp_path / "out"
    parent = subprocess.Popen(
        [sys.executable, "-m", "myork", "solve", deck, "--out", out, *LONG, loudness],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    log = out / "run.log.part"
    wait_for(lambda: log.is_file() and "step   2/" in log.read_text())
    solver = int((out / ".lock").read_text())
    assert solver != parent.pid
    parent.kill()
    parent.wait()
    wait_for(lambda: (out / "run.log").is_file())
    summary = read_summary(out)
    assert summary["converged"] is False and summary["steps"][-1]["load"] > 0.0
    wait_for(lambda: not Path(f"/proc/{solver}").exists())


@pytest.mark.slow
@pytest.mark.parametrize("how", ["link", "pipe", "second name"])
def test_output_does_not_follow_names(deck: Path, tmp_path: Path, how: str) -> None:
    """With a link in place of an output, its target would be overwritten by the user's run."""
    out, theirs = tmp_path / "out", tmp_path / "theirs"
    out.mkdir()
    theirs.write_text("theirs")
    names = ("results.vtkhdf", "history.csv", "run.log", "summary.json")
    for name in (".lock", *(f"{name}.part" for name in names), "results.journal"):
        place = out / name
        place.unlink(missing_ok=True)
        lay = {"link": place.symlink_to, "second name": place.hardlink_to}
        lay[how](theirs) if how in lay else os.mkfifo(place)
        ended = solve(deck, out)
        assert theirs.read_text() == "theirs", name
        if how == "second name" and name != ".lock":
            assert ended.returncode == 0, "what is there is removed, and its other name stays"
            continue
        assert ended.returncode == 2 and f"{name}: " in ended.stderr, name
        assert "it is" in ended.stderr and "remove it" in ended.stderr
        place.unlink()
    assert solve(deck, out).returncode == 0


@pytest.mark.slow
def test_a_journal_that_is_another_name_is_not_resumed(deck: Path, tmp_path: Path) -> None:
    out, theirs = tmp_path / "out", tmp_path / "theirs"
    run = begun(deck, out)
    run.kill()
    run.wait()
    journal = out / "results.journal"
    journal.rename(theirs)
    before = theirs.read_bytes()
    journal.symlink_to(theirs)
    ended = solve(deck, out, *LONG, "--resume")
    assert ended.returncode == 2 and "results.journal: cannot be written: it is" in ended.stderr
    assert theirs.read_bytes() == before


def test_a_station_that_fails_marks_what_it_leaves(tmp_path: Path) -> None:
    update_summary(tmp_path, {"model": {"volume": 1.0}, "units": {}})
    with pytest.raises(ValueError, match="no such slice"), renewing(tmp_path, "model", "tissue"):
        raise ValueError("no such slice")
    found = read_summary(tmp_path)
    assert found == {"model": {"volume": 1.0, "failed": "no such slice"}, "units": {}}
    said = "The model is that of an earlier run; the last one: no such slice"
    assert failures(found) == [said]
    with renewing(tmp_path, "model"):
        update_summary(tmp_path, {"model": {"volume": 2.0}})
    assert not failures(read_summary(tmp_path))


@pytest.mark.parametrize("command", ["solve", "build"])
def test_a_mistyped_deck_changes_no_folder(command, tmp_path, capsys) -> None:
    out = tmp_path / "out"
    for earlier in (False, True):
        if earlier:
            out.mkdir()
            (out / "summary.json").write_text("{}")
        assert main([command, str(tmp_path / "typo.toml"), "--out", str(out)]) == 2
        assert "No such file" in capsys.readouterr().err
        assert [path.name for path in out.glob("*")] == ["summary.json"] * earlier
