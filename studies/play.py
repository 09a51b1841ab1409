"""Times of the page of `kinfeas play` in a headless Chromium: first picture, and frames per second.

python studies/play.py OUT [WIDTH HEIGHT]    # writes OUT/first.png, OUT/drag.png
"""

import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from browser import Browser, on_screen
from PIL import Image

FULL = 100  # least number of colours in a picture with the robot


def first_picture(browser: Browser, out: Path) -> tuple[float, float]:
    """Return the seconds from the command to the address, and to a picture of the robot."""
    began = time.monotonic()
    command = [sys.executable, "-m", "kinfeas", "play", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = process.stdout.readline()
        address_after = time.monotonic() - began
        browser.call("Page.navigate", url=address.strip())
        colours = 0
        while colours < FULL:
            try:
                browser.screenshot(out)
            except KeyError:  # the page has no picture yet
                continue
            after = time.monotonic() - began
            pixels = np.array(Image.open(out).convert("RGB")).reshape(-1, 3)
            colours = len(np.unique(pixels // 8, axis=0))
    finally:
        process.kill()
        process.wait()
    return address_after, after


def frame_rates(browser: Browser, out: Path, seconds: float = 10.0) -> tuple[float, float]:
    """Return frames per second, of the robot and of the browser, while the target is dragged."""
    from kinfeas.viz.play import Choice, PlayPage
    from kinfeas.viz.server import serving

    with serving("kinfeas play") as server:
        page = PlayPage(server, Choice("pr2"), out.parent)
        page.start()
        thread = threading.Thread(target=page.run, args=(seconds + 30.0,), daemon=True)
        thread.start()
        browser.call("Page.navigate", url=f"http://127.0.0.1:{server.get_port()}")
        browser.wait(server.get_clients)
        time.sleep(15.0)
        camera = next(iter(server.get_clients().values())).camera
        x, y = on_screen(camera, page.handle.position + np.array([0.0, 0.0, 0.25]))
        browser.value("window.n = 0; (function f() { window.n++; requestAnimationFrame(f) })(); 0")
        browser.mouse("mouseMoved", x, y)
        time.sleep(1.0)
        browser.mouse("mousePressed", x, y)
        began, frames, drawn = time.monotonic(), page.frames, browser.value("window.n")
        heights = [page.handle.position[2]]
        while (now := time.monotonic() - began) < seconds:
            browser.mouse("mouseMoved", x, y - 40.0 * np.sin(now))
            heights.append(page.handle.position[2])
        rates = (page.frames - frames) / now, (browser.value("window.n") - drawn) / now
        browser.mouse("mouseReleased", x, y)
        browser.screenshot(out)
        assert np.ptp(heights) > 0.01
        thread.join()
        page.close()
    return rates


def main() -> None:
    """Print the times."""
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    size = (int(sys.argv[2]), int(sys.argv[3])) if len(sys.argv) > 3 else (1280, 800)
    with tempfile.TemporaryDirectory() as folder:
        browser = Browser(Path(folder), size)
        try:
            for _ in range(2):
                address, picture = first_picture(browser, out / "first.png")
                print(f"address {address:.2f} s, first picture {picture:.2f} s")
            simulated, drawn = frame_rates(browser, out / "drag.png")
            print(f"dragging: robot {simulated:.1f} frames/s, browser {drawn:.1f} frames/s")
        finally:
            browser.close()


if __name__ == "__main__":
    main()
