"""A headless Chromium over its DevTools protocol, for live pages."""

import base64
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from kinfeas.core.spatial import rotation

BINARY = shutil.which("chromium") or shutil.which("google-chrome")
_PAUSE = 0.005  # s, between polls


class Browser:
    """One page of a headless Chromium."""

    def __init__(self, folder: Path, size: tuple[int, int]) -> None:
        """Start with a new profile in `folder`."""
        if BINARY is None:
            raise SystemExit("neither chromium nor google-chrome is installed")
        from websockets.sync.client import connect

        self._numbers = count(1)
        self._process = subprocess.Popen(
            [
                BINARY, "--headless=new", "--no-sandbox", "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader", "--remote-debugging-port=0",
                f"--window-size={size[0]},{size[1]}", f"--user-data-dir={folder}", "about:blank",
            ],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        port_file = folder / "DevToolsActivePort"
        self.wait(lambda: port_file.exists() and port_file.read_text().count("\n") > 0)
        port = port_file.read_text().splitlines()[0]
        pages = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json"))
        page = next(entry for entry in pages if entry["type"] == "page")
        self._socket = connect(page["webSocketDebuggerUrl"], max_size=None)
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=size[0], height=size[1], deviceScaleFactor=1, mobile=size[0] < 600,
        )  # fmt: skip

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return the result of a command of the protocol."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            try:
                answer = json.loads(self._socket.recv(timeout=0.0))
            except TimeoutError:
                time.sleep(_PAUSE)
                continue
            if answer.get("id") == number:
                result: dict[str, Any] = answer["result"]
                return result

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        return result["result"].get("value")

    def wait(self, condition: Callable[[], object], seconds: float = 120.0) -> None:
        """Wait until a condition holds."""
        ends = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < ends
            time.sleep(_PAUSE)

    def mouse(self, kind: str, x: float, y: float) -> None:
        """Send `mousePressed`, `mouseMoved` or `mouseReleased` at a point of the page."""
        pressed = kind != "mouseReleased"
        self.call(
            "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left",
            buttons=int(pressed), clickCount=int(kind != "mouseMoved"),
        )  # fmt: skip

    def screenshot(self, path: Path) -> None:
        """Write the page as a PNG file."""
        image = self.call("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(image))

    def close(self) -> None:
        """End the browser."""
        self._socket.close()
        self._process.terminate()
        self._process.wait()


def on_screen(camera: Any, point: Any) -> tuple[float, float]:
    """Return the pixel of a world point."""
    pose = np.concatenate([camera.position, np.roll(camera.wxyz, -1)])
    x, y, z = rotation(pose).as_matrix().T @ (point - camera.position)
    focal = camera.image_height / 2.0 / np.tan(camera.fov / 2.0)
    return camera.image_width / 2.0 + focal * x / z, camera.image_height / 2.0 + focal * y / z
