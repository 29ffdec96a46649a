"""The page of a reduced model, in a real browser: it shows the numbers of the model; the demo."""

import io
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

from myork import ReducedModel
from myork.cli import main
from myork.rom.model import OUTSIDE
from myork.stations.solve import run_deck
from myork.view import still
from myork.view.answers import FIELDS, Answers
from tests.scenes import contracting, deck_file, probes, refuses

pytestmark = pytest.mark.nightly

DECK = contracting(
    3, 3, 5, title="block <of> muscle",
    probe=probes("middle u 0.5 0.5 1", "reaction force_z z1"),
)  # fmt: skip
RANGES = {
    "load.activation": (0.0, 0.8),
    "boundary.z1.u_z": (-0.2, 0.3),
    "material.muscle.sigma_max": (20.0, 40.0),
}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    deck = deck_file(tmp_path_factory.mktemp("view") / "block.toml", DECK)
    rom = ReducedModel.train(deck, RANGES, full_solves=12, tests=2, threads=1)
    return rom.save(deck.with_name("block.rom.h5"))


@pytest.fixture(scope="module")
def answers(trained: Path) -> Iterator[Answers]:
    with Answers(trained) as found:
        yield found


def start(trained: Path, **variables: str) -> tuple[subprocess.Popen[str], str]:
    """The command and the address that it prints."""
    server = subprocess.Popen(
        [sys.executable, "-m", "myork", "view", str(trained), "--no-browser"],
        env={**os.environ, **variables},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert server.stdout is not None and server.stderr is not None
    line = server.stdout.readline()
    found = re.search(r"http://127\.0\.0\.1:\d+/\S*", line)
    assert found, (line, server.stderr.read())
    return server, found[0]


@pytest.fixture(scope="module")
def address(trained: Path) -> Iterator[str]:
    server, found = start(trained)
    yield found
    server.terminate()
    assert server.wait(20) == 0


def asked(address: str) -> tuple[dict[str, Any], np.ndarray]:
    """JSON and numbers of an answer."""
    with urllib.request.urlopen(address, timeout=60) as answer:
        content = answer.read()
    size = struct.unpack("<I", content[:4])[0]
    return json.loads(content[4 : 4 + size]), np.frombuffer(content[4 + size :], "<f4")


def answer(address: str, path: str) -> tuple[int, str]:
    """Status and text of an answer."""
    try:
        with urllib.request.urlopen(address + path, timeout=60) as found:
            return found.status, found.read().decode("latin-1")
    except urllib.error.HTTPError as refused:
        return refused.code, refused.read().decode()


def slide(page: Any, number: int, value: float) -> None:
    page.evaluate(
        "([k, x]) => { const s = document.getElementById(`p${k}`); s.value = x;"
        " s.dispatchEvent(new Event('input')); }", [number, value],
    )  # fmt: skip
    near = "([k, x]) => shown.values && Math.abs(shown.values[k] - x) < 1e-9"
    page.wait_for_function(near, arg=[number, value])


def opened_at(open_page: Any, address: str) -> Any:
    page = open_page(address)
    page.wait_for_function("shown.answers > 0")
    return page


def picture(page: Any) -> np.ndarray:
    content = io.BytesIO(page.locator("#body").screenshot())
    return np.asarray(Image.open(content).convert("RGB"))


def test_force_shown_is_that_of_rom_solve(open_page, address, trained, capsys):
    page = opened_at(open_page, address)
    for number, value in enumerate((0.4, 0.13, 33.0)):
        slide(page, number, value)
    values = ["--set", "activation=0.4", "--set", "u_z=0.13", "--set", "sigma_max=33"]
    assert main(["rom", "solve", str(trained), *values, "--json"]) == 0
    expected = json.loads(capsys.readouterr().out)
    force = expected["probes"]["reaction"]
    # forces come first
    assert page.evaluate("shown.probes[0]") == pytest.approx(force, rel=1e-12)
    assert page.inner_text("#probe0") == f"{force:.4g}"
    indicator, unit = page.inner_text("#indicator").split()
    assert unit == "%" and float(indicator) == pytest.approx(100 * expected["indicator"], rel=0.06)
    assert page.inner_text("#verdict") == ("? doubtful" if expected["doubts"] else "✓ accepted")
    assert page.inner_text("h1").startswith("block <of> muscle")
    # a curve for each parameter, with the state on it
    assert page.locator("#curves svg circle").count() == 3
    # sixty moves: each answer is drawn, the last one belongs to the last value
    before = page.evaluate("shown.answers")
    page.evaluate(
        "async () => { const s = document.getElementById('p0');"
        " for (let k = 1; k <= 60; k++) { s.value = 0.01 * k; s.dispatchEvent(new Event('input'));"
        " await new Promise(requestAnimationFrame); } }"
    )
    page.wait_for_function("shown.values[0] === 0.6 && !busy && !wanted")
    assert page.evaluate("shown.answers") > before + 1
    # outside the range, with the tolerance of the verdict
    for number, value in ((0, 0.5), (2, 30.0), (1, 0.34)):
        slide(page, number, value)
    assert page.inner_text("#verdict") == "? doubtful"
    footer = page.inner_text("footer")
    assert "the tolerance of the training, 0.1 % of the largest displacement, is" in footer
    reasons = page.inner_text("#reasons")
    assert "boundary.z1.u_z = 0.34 is outside the trained range -0.2 to 0.3" in reasons
    assert page.locator(".slider.outside").count() == 1


def test_the_body_follows_the_sliders(open_page: Any, address: str) -> None:
    page, seen = opened_at(open_page, address), []
    for length in (-0.2, 0.3):
        slide(page, 1, length)
        seen.append(picture(page))
    assert 0.03 < (seen[0] < 200).any(axis=2).mean() < 0.9
    # the pulled end is higher on the screen: the undeformed body is drawn in both
    rows = [np.flatnonzero((p < 120).any(axis=2).any(axis=1)).min() for p in seen]
    assert rows[1] < rows[0] - 5
    colours = set()
    for field in FIELDS:
        page.select_option("#field", field)
        before = page.evaluate("shown.answers - 1")
        page.wait_for_function("(n) => shown.answers > n && !busy", arg=before)
        page.wait_for_function("() => !wanted && !busy")
        colours.add((picture(page).astype(int).sum(), page.inner_text("#high")))
    assert len(colours) == len(FIELDS)
    # rotated by the mouse
    before, box = picture(page), page.locator("#body").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 320, box["y"] + 240, steps=4)
    page.mouse.up()
    assert (picture(page) != before).any()
    # normals at the corners of its triangles are those of the faces of a block
    found = page.evaluate("source.surface().then(([rest]) => Array.from(body.normals(rest)))")
    normals = np.abs(np.reshape(found, (-1, 3)))
    most = normals.max(axis=1)
    assert len(normals) == 3 * 80
    assert most == pytest.approx(np.linalg.norm(normals, axis=1), rel=1e-6) and most.min() > 0.0


def test_no_number_without_a_state(address: str) -> None:
    facts, numbers = asked(f"{address}state?p=0.8,-1.9,40&field=J")
    assert facts["verdict"] == "refused" and not facts["converged"] and not facts["inside"]
    assert facts["reasons"][0] == "the reduced model did not converge"
    assert len(numbers) % 4 == 0


def test_positions_and_fields(answers: Answers) -> None:
    """Displacements are the model's, J and stress those of the full scene at the state."""
    values = [0.5, 0.2, 30.0]
    shown = answers.state(values, "displacement")
    state = answers.rom.solve(activation=0.5, u_z=0.2, sigma_max=30.0)
    moved = {tuple(np.round(x, 9)) for x in (answers.rest + 0.0)}
    points = answers.rom.full_model().open().points()
    on = [tuple(np.round(x, 9)) in moved for x in points]
    # of three by three by five points only three lie inside
    assert len(answers.rest) == np.sum(on) == 42
    assert shown.positions == pytest.approx(points[on] + state.u()[on], abs=1e-9)
    assert shown.values == pytest.approx(np.linalg.norm(state.u()[on], axis=1), abs=1e-9)
    words = ["load.activation=0.5", "boundary.z1.u_z=0.2", "load.steps=1"]
    with answers.rom.full_model().open(words) as scene:
        x = answers.rom.basis @ answers.rom.batch(np.array([values])).amplitudes[0]
        fields = scene.fields(x, 1.0).named
    assert shown.facts["J"] == pytest.approx([fields["J"].min(), fields["J"].max()], rel=1e-6)
    principal = answers.state(values, "principal").values
    assert principal == pytest.approx(fields["principal_stress"].max(axis=1)[on], rel=1e-6)
    # materials are those of the state, also after another
    low, high = (answers.state([0.5, 0.2, s], "von_mises").values.max() for s in (20.0, 40.0))
    assert high > 1.2 * low
    assert answers.state([0.5, 0.2, 20.0], "von_mises").values.max() == low


def test_small_states_are_judged_by_the_largest(answers: Answers) -> None:
    """Like probes, which are judged by their kind: tiny displacements have no relative error."""
    rom = answers.rom
    for values, small in (([0.0, 1e-4, 30.0], True), ([0.8, 0.3, 30.0], False)):
        batch = rom.batch(np.array([values]), indicator=True)
        size = np.linalg.norm(batch.amplitudes[0])
        assert (size < 0.1 * rom.largest) == small
        expected = batch.indicator[0] * min(1.0, size / (0.1 * rom.largest))
        facts = answers.state(values, "J").facts
        assert facts["indicator"] == pytest.approx(expected, rel=1e-6)


def test_the_error_of_the_full_model_is_in_that_of_the_force(answers, trained, tmp_path):
    """If it was solved beside the model, from the same deck with any values of the parameters."""
    assert answers.about()["bar"]["full"] is None
    found = {}
    for name, more in (("same", ()), ("other", ["material.muscle.K=400"])):
        out = tmp_path / name
        # at more activation two cells across are too few
        words = ["load.activation=0.1", *more]
        run_deck(trained.with_name("block.toml"), out, overrides=words, threads=1)
        with Answers(Path(shutil.copy(trained, out))) as beside:
            found[name] = beside.about()["bar"]
    assert found["other"] == answers.about()["bar"]
    last = json.loads((tmp_path / "same" / "summary.json").read_text())["steps"][-1]
    expected = last["probe_errors"]["reaction"] / abs(last["probes"]["reaction"])
    assert found["same"]["full"] == pytest.approx(expected, rel=1e-9) and expected > 0.0
    assert found["same"]["reduced"] == answers.rom.certificate["force"]["max"]


def test_rounding_is_zero(answers: Answers) -> None:
    for field in ("von_mises", "principal", "displacement"):
        low, high = answers.ranges[field]
        assert low == 0.0 or abs(low) > 1e-9 * high
        assert answers.state([0.0, 0.0, 30.0], field).facts["range"] == [0.0, 0.0]


def test_angles_of_fibers_move(tmp_path: Path) -> None:
    """A scene whose fibers turn is a different one; its fields are those of the state."""
    deck = deck_file(tmp_path / "turning.toml", DECK)
    key = "material.muscle.fiber_angle"
    ranges = {key: (5.0, 25.0), "load.activation": (0.0, 0.5)}
    rom = ReducedModel.train(deck, ranges, full_solves=8, tests=0, threads=1)
    with Answers(rom.save(tmp_path / "turning.rom.h5")) as found:
        assert found.about()["parameters"][0]["unit"] == "°"
        shown = [found.state([angle, 0.4], "principal").values for angle in (8.0, 21.0, 8.0)]
        assert np.array_equal(shown[0], shown[2])
        x = rom.basis @ rom.batch(np.array([[21.0, 0.4]])).amplitudes[0]
        with rom.full_model().open([f"{key}=21.0", "load.activation=0.4", "load.steps=1"]) as scene:
            stress = scene.fields(x, 1.0).named["principal_stress"].max(axis=1)
        assert shown[1].max() <= stress.max() * (1 + 1e-6)
        assert np.isin(np.round(shown[1], 8), np.round(stress, 8)).all()


def test_curves_pass_through_the_state(answers: Answers) -> None:
    values = [0.4, 0.05, 30.0]
    facts = answers.state(values, "J").facts
    for one in (answers.curve(values, 0, k) for k in range(3)):
        y = np.interp(values[one["parameter"]], one["x"], one["y"])
        assert y == pytest.approx(facts["probes"][0], rel=0.01)
    # more activation, more force
    assert np.all(np.diff(answers.curve(values, 0, 0)["y"]) > 0)


@pytest.mark.parametrize(("path", "status", "message"), [
    ("state?p=0.1,0&field=J", 400, "shape (n, 3) with at least one row, not (1, 2)"),
    ("state?p=0.1,0,nan&field=J", 400, "p: finite numbers are needed"),
    ("state?p=0.1,0,much&field=J", 400, "p: '0.1,0,much' is not a list of numbers"),
    ("state?p=0.1,0,30&field=heat", 400, "heat: no field; there are von_mises"),
    ("state?field=J", 400, "p: is missing"),
    ("state?p=0.1,0,30", 400, ": no field; there are von_mises"),
    ("curves?p=0.1,0,30&probe=9", 400, "probe 9: there are 4"),
    ("curves?p=0.1,0,30&probe=one", 400, "probe: 'one' is not a list of numbers"),
    ("curves?p=0.1,0,30&probe=0&of=3", 400, "of: numbers of parameters from 0 to 2"),
    ("curves?p=0.1,0,30&probe=0&of=-1", 400, "of: numbers of parameters from 0 to 2"),
    ("state?p=" + "0," * 40000, 414, "Too Long"),
    ("../etc/passwd", 404, "no such page"),
])  # fmt: skip
def test_wrong_questions(address: str, path: str, status: int, message: str) -> None:
    found, text = answer(address, path)
    assert found == status and message in text


@pytest.mark.parametrize(("path", "host", "status", "message"), [
    ("TOKEN/surface", "127.0.0.1:PORT", 200, ""),
    ("TOKEN", "LOCALHOST:PORT", 200, "<title>block"),
    ("TOKEN/", "[::1]:PORT", 200, "<title>block"),
    ("", "127.0.0.1:PORT", 403, "lacks the token"),
    ("surface", "127.0.0.1:PORT", 403, "lacks the token"),
    ("TOKE/surface", "127.0.0.1:PORT", 403, "lacks the token"),
    ("\xe9/surface", "127.0.0.1:PORT", 403, "lacks the token"),
    ("TOKEN/", "example.org", 403, "Host: example.org; this page answers as 127.0.0.1:"),
    ("TOKEN/", "127.0.0.1", 403, "the same port at both ends"),
    ("TOKEN/", "127.0.0.1.example.org:PORT", 403, "Host: "),
    ("TOKEN/", "", 403, "Host: missing"),
])  # fmt: skip
def test_who_is_answered(address: str, path: str, host: str, status: int, message: str) -> None:
    url = urlsplit(address)
    words = {"TOKEN": url.path.strip("/"), "PORT": str(url.port)}
    for word, value in words.items():
        path, host = path.replace(word, value), host.replace(word, value)
    lines = [f"GET /{path} HTTP/1.1", f"Host: {host}" if host else "X: y", "Connection: close"]
    with socket.create_connection((url.hostname, url.port), timeout=60) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode("latin-1"))
        content = connection.makefile("rb").read()
    assert content.startswith(f"HTTP/1.1 {status} ".encode())
    assert message in content.decode("utf-8", "replace")


def test_verdicts_are_those_of_sweeps(answers):
    """For states inside and outside the range; the page names exceeded ranges."""
    rng = np.random.default_rng(1)
    low, high = np.array(list(RANGES.values())).T
    rows = np.vstack([low + (high - low) * rng.random((12, 3)), high + 0.1 * (high - low)])
    batch = answers.rom.batch(rows, indicator=True)
    assert {batch.verdict(k)[0] for k in range(len(rows))} == {"accepted", "doubtful"}
    for k, row in enumerate(rows.tolist()):
        verdict, reasons = batch.verdict(k)
        facts = answers.state(row, "J").facts
        assert facts["verdict"] == verdict
        outside = [reason for reason in facts["reasons"] if "outside the trained range" in reason]
        assert len(outside) == (0 if batch.inside[k] else 3)
        assert set(reasons) - {OUTSIDE} <= set(facts["reasons"])


def test_a_page_without_a_server(open_page, answers, trained, tmp_path, capsys):
    """Sampled states are the model's, values between them are linear, and the page says both."""
    file = tmp_path / "block.html"
    assert main(["view", str(trained), "--still", str(file), "-q"]) == 0
    assert capsys.readouterr().out == f"page: {file}\n"
    assert [path.name for path in tmp_path.iterdir()] == [file.name]
    assert file.stat().st_size < still.MOST_BYTES
    page = open_page(file.as_uri())
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.wait_for_function("shown.answers > 0")
    footer = page.inner_text("footer")
    assert "343 states were sampled (7 × 7 × 7)" in footer
    assert "between them values are interpolated, linearly in each parameter" in footer
    # no slider leaves the range that was sampled
    assert [page.get_attribute("#p1", end) for end in ("min", "max")] == ["-0.2", "0.3"]
    # activation, length, stress: the states at 3, 4 and 5 of 0 to 6, and half of the way on
    step = np.array([0.8, 0.5, 20.0]) / 6
    ends = [np.array([0.0, -0.2, 20.0]) + step * (3 + more, 4, 5) for more in (0, 1)]
    shown = [answers.fields(end.tolist()) for end in ends]
    low, high = answers.ranges["J"]
    for values, expected in ((ends[0], shown[:1]), (0.5 * (ends[0] + ends[1]), shown)):
        for number, value in enumerate(values):
            slide(page, number, float(value))
        force = np.mean([facts["probes"][0] for facts, *_ in expected])
        assert page.evaluate("shown.probes[0]") == pytest.approx(force, rel=1e-6)
        assert page.inner_text("#probe0") == f"{force:.4g}"
        worst = {facts["verdict"] for facts, *_ in expected} - {"accepted"}
        assert page.inner_text("#verdict") == ("? doubtful" if worst else "✓ accepted")
        found = page.evaluate(
            "async (v) => (await source.state(v, 'J')).slice(1).map((x) => Array.from(x))",
            values.tolist(),
        )
        places = np.mean([where for _, where, _ in expected], axis=0)
        assert np.reshape(found[0], (-1, 3)) == pytest.approx(places, abs=2e-4)
        fields = [np.clip(one[list(FIELDS).index("J")], low, high) for *_, one in expected]
        assert found[1] == pytest.approx(np.mean(fields, axis=0), abs=(high - low) / 254)
    # the error is that of the check and of the interpolation
    bar = float(page.inner_text("#bar0").removeprefix("± "))
    truth = answers.state([float(v) for v in values], "J").facts["probes"][0]
    assert abs(truth - force) < bar < 0.05 * abs(force)
    assert page.locator("#curves svg circle").count() == 3
    # no state is interpolated from one that was not found
    page.evaluate("held.states.forEach((state) => { state.converged = false; })")
    slide(page, 0, 0.1)
    assert page.inner_text("#verdict") == "✗ refused" and page.inner_text("#probe0") == "–"
    assert asked == []


@pytest.mark.parametrize(("name", "message"), [
    ("block.rom.h5", "--still TMP/block.rom.h5: the name must end in .html"),
    ("none/block.html", "TMP/none/block.html: cannot be written: No such file or directory"),
])  # fmt: skip
def test_where_no_page_is_written(trained, tmp_path, capsys, monkeypatch, name, message):
    """Nothing is computed before."""
    monkeypatch.setattr(still, "sample", lambda *_, **__: pytest.fail("states are computed"))
    assert main(["view", str(trained), "--still", str(tmp_path / name), "-q"]) == 2
    assert message.replace("TMP", str(tmp_path)) in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_a_body_too_large_for_a_page(trained: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parameters lose their sliders first, activation last."""
    monkeypatch.setattr(still, "MOST_BYTES", 20_000)
    found = still.sample(trained)
    assert found["held"]["stops"] == 5 and len(found["held"]["states"]) == 25
    keys = [parameter["key"] for parameter in found["about"]["parameters"]]
    assert keys == ["load.activation", "boundary.z1.u_z"]
    assert found["held"]["fixed"] == {"material.muscle.sigma_max": 30.0}
    monkeypatch.setattr(still, "MOST_BYTES", 1_500)
    refuses("has 42 corners: three states are larger than the 0.001", still.sample, trained)


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_it_ends_cleanly(trained: Path, tmp_path: Path, sign: signal.Signals) -> None:
    server, address = start(trained, TMPDIR=str(tmp_path))
    assert asked(f"{address}surface")[0]["corners"] == 42
    server.send_signal(sign)
    out, error = server.communicate(timeout=20)
    assert server.returncode == 0 and out == "view ended\n" and error == ""
    assert not any(tmp_path.iterdir())


def test_a_port_in_use(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is detected before the model is read: there is none."""
    absent = str(tmp_path / "absent.rom.h5")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert main(["view", absent, "--no-browser", "--port", str(port)]) == 2
    assert f"--port {port}: is in use; choose another" in capsys.readouterr().err


def test_no_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(tmp_path / "none.rom.h5"), "--no-browser"]) == 2
    assert "there is no such reduced model" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["view", "x.rom.h5", "--port", "70000"])
    assert "between 0 and 65535" in capsys.readouterr().err


def test_it_ends_accepted(open_page, tmp_path, capsys):
    assert main(["demo", "--out", str(tmp_path), "--threads", "1"]) == 0
    said = capsys.readouterr().out
    summary = json.loads((tmp_path / "summary.json").read_text())
    # nothing is lost anywhere, at zero load
    assert summary["verdict"]["state"] == "accepted" and summary["warnings"] == []
    last = summary["steps"][-1]
    force, bar = last["probes"]["reaction_top"], last["probe_errors"]["reaction_top"]
    assert 0.0 < bar < 0.06 * force
    assert f"reaction_top at load 1: {force:.4g} +- {bar:.2g} N" in said.splitlines()
    assert [f"station {k}/5" in said for k in range(1, 6)] == [True] * 5
    # the check is in its file and in the model
    check = json.loads((tmp_path / "check.json").read_text())
    assert check["failed"] == 0 and check["points"] == 6
    assert check["force"]["max"] < 1e-3 and check["u"]["max_of_largest"] < 2e-3
    assert check["certified"]["points"] == 6 and check["certified"]["u"] <= 1e-3
    (model,) = tmp_path.glob("*.rom.h5")
    rom = ReducedModel.load(model, threads=1)
    assert rom.certificate == check
    found = rom.solve(activation=0.3, u_z=0.0).probes["reaction_top"]
    assert found == pytest.approx(force, rel=1e-3)
    page = opened_at(open_page, (tmp_path / "mg_muscle.html").as_uri())
    slide(page, 0, 0.3)
    at = page.evaluate("about.probes.findIndex((p) => p.name === 'reaction_top')")
    assert page.evaluate("shown.probes")[at] == pytest.approx(force, rel=1e-3)
    assert page.inner_text("#verdict") == "✓ accepted"
    # the error of the full model is included in that of the force
    of = page.evaluate("about.bar")
    off = (of["full"] + of["reduced"]) * force + of["between"]
    assert bar < off < 1.02 * bar
    assert page.inner_text("#bar0") == f"± {off:.2g}"
    report = open_page((tmp_path / "report.html").as_uri())
    assert report.inner_text("h1").endswith("✓ numerical error accepted phantom data")
