"""Frames of the page of a reduced model while a slider moves, in a headless Chromium; run by hand.

    python benchmarks/view_frames.py MODEL.rom.h5 [--seconds S] [--picture FILE.png]

For each parameter its slider goes up and down through the range of the training, a new value with
each picture of the screen. Counted are states that the page has drawn; processor time is that of
the server and of all processes of the browser, which draws WebGL on the processor here.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from playwright.sync_api import sync_playwright

#: Ticks a second
TICKS = os.sysconf("SC_CLK_TCK")
#: A slider's way up and down takes this long [s]
PERIOD = 4.0
MOVE = """async ([k, low, high, seconds, period]) => {
  const s = document.getElementById(`p${k}`), begin = performance.now(), first = shown.answers;
  let moves = 0;
  for (let t = 0; t < seconds; t = (performance.now() - begin) / 1000) {
    const part = 0.5 - 0.5 * Math.cos(2 * Math.PI * t / period);
    s.value = low + part * (high - low);
    s.dispatchEvent(new Event("input"));
    moves += 1;
    await new Promise(requestAnimationFrame);
  }
  return [(performance.now() - begin) / 1000, moves, shown.answers - first];
}"""


def processor_ticks(pid: int) -> Counter[str]:
    """Processor time of a process and of those that it has started, by their kind [ticks]."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        # Chromium joins its words by blanks
        words = re.split(r"[\0 ]", Path(f"/proc/{pid}/cmdline").read_text())
        children = [
            int(word)
            for path in Path(f"/proc/{pid}/task").glob("*/children")
            for word in path.read_text().split()
        ]
    except OSError:
        return Counter()
    found: Counter[str] = Counter()
    for child in children:
        found.update(processor_ticks(child))
    kind = next((word[7:] for word in words if word.startswith("--type=")), "other")
    kind = "server" if "view" in words else kind
    found[kind] += int(fields[11]) + int(fields[12])
    return found


def main() -> None:
    """Serve the page, move its sliders, print a table."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("model", type=Path)
    words.add_argument("--seconds", type=float, default=12.0, help="of each slider")
    words.add_argument("--picture", type=Path, help="a screenshot of the page, in motion")
    options = words.parse_args()
    names = ("chromium", "chromium-browser", "google-chrome")
    chromium = next((found for name in names if (found := shutil.which(name))), None)
    assert chromium is not None, "a Chromium is needed"
    line = [sys.executable, "-m", "myork", "view", str(options.model), "--no-browser"]
    server = subprocess.Popen(line, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    address = re.search(r"http://127\.0\.0\.1:\d+/\S*", server.stdout.readline())
    assert address, "the server did not start"
    try:
        with sync_playwright() as driver:
            flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
            browser = driver.chromium.launch(executable_path=chromium, args=flags)
            page = browser.new_page(viewport={"width": 1400, "height": 860})
            page.goto(address[0])
            page.wait_for_function("shown.answers > 0 && !busy && !wanted", timeout=120_000)
            ranges = page.evaluate("about.parameters.map((p) => [p.key, p.low, p.high])")
            triangles = page.evaluate("body.triangles.length / 3")
            print(f"{options.model.name}: {triangles:.0f} triangles; processor ms a frame:")
            print(f"{'slider':<28}  frames/s  moves/s    server      page     WebGL     other")
            for k, (key, low, high) in enumerate(ranges):
                before = processor_ticks(os.getpid())
                seconds, moves, frames = page.evaluate(
                    MOVE, [k, low, high, options.seconds, PERIOD]
                )
                spent = processor_ticks(os.getpid())
                spent.subtract(before)
                shown = [spent.pop(kind, 0) for kind in ("server", "renderer", "gpu-process")]
                told = [f"{1e3 * part / TICKS / frames:8.1f}" for part in (*shown, spent.total())]
                print(
                    f"{key:<28}  {frames / seconds:8.1f} {moves / seconds:8.1f}  "
                    + "  ".join(told),
                    flush=True,
                )
                page.wait_for_function("!busy && !wanted", timeout=120_000)
            if options.picture:
                time.sleep(1.0)
                page.screenshot(path=str(options.picture))
            browser.close()
    finally:
        server.terminate()
        server.wait(20)


if __name__ == "__main__":
    main()
