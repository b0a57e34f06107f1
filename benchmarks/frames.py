"""Frames a second of the view's page, idle and playing, over those of another tree's page.

    python benchmarks/frames.py OTHER_TREE [--rounds 3] [--seconds 4] [--emulated]

Chromium without a graphics card opens a hexapod with 100 poses, its identified machine and a cloud
of 30,000 positions, made by each tree in turn, and by this one with all that a result adds. Frames
are those that the browser shows (``requestAnimationFrame``); while playing also those of them in
which WebGL drew something and the machine was elsewhere than before. Printed: medians of the
rounds, times to load and sizes. Chromium without a graphics card composes its page in plain
software; ``--emulated`` has it emulate a card for that too, which takes 25 ms a frame alone.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

HERE = Path(__file__).parents[1]
MAKE = """
import sys
import numpy as np
import pincal
mechanism = pincal.load_mechanism("6UPS")
truth = pincal.disturb(mechanism, 1e-3, seed=1)
draw = np.random.default_rng(2)
plan = pincal.Plan(mechanism.platform.home + draw.uniform(-0.1, 0.1, (100, 6)))
cloud = np.array(mechanism.platform.home)[:3] + draw.uniform(-0.3, 0.3, (30_000, 3))
view = pincal.view(mechanism, plan, workspace=cloud, identified=truth)
if sys.argv[2] == "result":
    noise = pincal.Noise(5e-5, 5e-5)
    data = pincal.simulate(mechanism, truth, plan, noise, 3).measurements
    view = view.with_result(pincal.calibrate(mechanism, data, noise=noise))
view.save(sys.argv[1], force=True)
"""
# Draw calls of all canvases, from the start on
CALLS = """() => {
  window.calls = 0;
  for (const kind of [WebGLRenderingContext, WebGL2RenderingContext]) {
    for (const name of ["drawArrays", "drawElements"]) {
      const own = kind.prototype[name];
      kind.prototype[name] = function (...given) { window.calls += 1; own.apply(this, given); };
    }
  }
}"""
# Frames, and those of them in which something was drawn of a machine that had moved
COUNT = """(seconds) => new Promise((done) => {
  const begin = performance.now();
  const machine = window.pincal.viewer.scene_tree.find(["meshcat", "mechanism"]).object;
  let [frames, moved, calls, place] = [0, 0, window.calls, ""];
  const tick = (now) => {
    frames += 1;
    if (window.calls > calls) {
      let there = "";
      machine.traverse((one) => (there += one.matrix.elements.slice(12).join()));
      if (there !== place) moved += 1;
      place = there;
    }
    calls = window.calls;
    if (now - begin < 1e3 * seconds) requestAnimationFrame(tick);
    else done([frames, moved].map((one) => (1e3 * one) / (now - begin)));
  };
  requestAnimationFrame(tick);
})"""
WHAT = ("idle", "playing", "playing, drawn and moved", "load [s]")


def made(tree: Path, path: Path, kind: str) -> Path:
    """Write the page of a tree's pincal."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    command = [sys.executable, "-P", "-c", MAKE, str(path), kind]
    subprocess.run(command, cwd=tree, env=environment, check=True)
    return path


def measured(browser: Any, path: Path, seconds: float) -> list[float]:
    """Return frames a second idle, playing and drawn while playing, and the time to load [s]."""
    page = browser.new_context(viewport={"width": 1440, "height": 900}).new_page()
    page.add_init_script(f"({CALLS})()")
    begin = perf_counter()
    page.goto(path.as_uri())
    page.wait_for_function("() => window.pincal && window.pincal.drawn()")
    loaded = perf_counter() - begin
    page.wait_for_timeout(1000)
    idle, _ = page.evaluate(COUNT, seconds)
    page.locator("#play").click()
    page.wait_for_timeout(1000)
    playing, drawn = page.evaluate(COUNT, seconds)
    page.context.close()
    return [idle, playing, drawn, loaded]


def main() -> None:
    """Measure the pages in turn and print them."""
    from playwright.sync_api import sync_playwright

    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("tree", type=Path, help="the other tree")
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--seconds", type=float, default=4.0)
    options.add_argument("--emulated", action="store_true", help="compose the page by WebGL too")
    given = options.parse_args()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    flags = ["--use-angle=swiftshader" if given.emulated else "--disable-gpu"]
    flags += ["--enable-unsafe-swiftshader"]
    flags += ["--no-sandbox"] if os.geteuid() == 0 else []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        pages = {
            "other": made(given.tree.resolve(), Path(folder) / "other.html", "plain"),
            "this": made(HERE, Path(folder) / "this.html", "plain"),
            "this, with a result": made(HERE, Path(folder) / "result.html", "result"),
        }
        browser = playwright.chromium.launch(executable_path=chromium, args=flags)
        rounds = [
            [measured(browser, path, given.seconds) for path in pages.values()]
            for _ in range(given.rounds)
        ]
        browser.close()
        middle = np.median(rounds, axis=0)
        for name, path, values in zip(pages, pages.values(), middle, strict=True):
            said = "  ".join(f"{what} {one:.3g}" for what, one in zip(WHAT, values, strict=True))
            print(f"{name}: {said}  size {path.stat().st_size / 1e6:.2f} MB")
        for name, values in zip(list(pages)[1:], middle[1:], strict=True):
            ratios = values / middle[0]
            said = "  ".join(f"{what} {one:.2f}" for what, one in zip(WHAT, ratios, strict=True))
            print(f"{name} over other: {said}")


if __name__ == "__main__":
    main()
