import socket
import sys
import threading
import urllib.error
import urllib.request
from importlib.metadata import version
from unittest.mock import Mock
from urllib.parse import urlsplit

import numpy as np
import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.core.spatial import distance
from kinfeas.io.demonstrations import read_demonstration

pytest.importorskip("viser")

import msgspec
import zstandard
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from kinfeas.viz.play import Choice, PlayPage
from kinfeas.viz.server import serving


class Client:
    """What a browser says to a page, and what it is told about controls and nodes."""

    def __init__(self, url, host=None, origin=None):
        parts = urlsplit(url)
        self._socket = connect(
            parts._replace(scheme="ws", netloc=host or parts.netloc).geturl(),
            sock=socket.create_connection((parts.hostname, parts.port)),
            origin=origin or f"http://{host or parts.netloc}",
            subprotocols=[f"viser-v{version('viser')}"],
            compression=None, max_size=None, close_timeout=0.1,
        )  # fmt: skip
        self.texts, self._controls, self.owner = {}, {}, None
        camera = {"fov": 1.0, "near": 0.1, "far": 9.0, "image_height": 6, "image_width": 8}
        axes = {"position": [3, 3, 3], "look_at": [0, 0, 0], "up_direction": [0, 0, 1]}
        self.send("ViewerCameraMessage", wxyz=[1, 0, 0, 0], **camera, **axes)

    def send(self, kind, **content):
        self._socket.send(msgspec.msgpack.encode({"type": kind, **content}))

    def read(self, until):
        while not until():
            raw = self._socket.recv(timeout=60.0)
            size = 16 + int.from_bytes(raw[8:16], "little")
            content = zstandard.ZstdDecompressor().decompress(raw[16:size], 1 << 24)
            for message in msgspec.msgpack.decode(content)["messages"]:
                self._take(message)

    def _take(self, message):
        if message["type"] == "GuiUpdateMessage":
            self._take_properties(message["uuid"], message["updates"])
        elif message["type"].startswith("Gui") and "props" in message:
            self._take_properties(message["uuid"], message["props"])
        elif message["type"] == "TransformControlsMessage":
            self.owner = message["owner"]

    def _take_properties(self, uuid, properties):
        if label := properties.get("label"):
            self._controls[label] = uuid
        if text := properties.get("_markdown"):
            self.texts[uuid] = text

    def update(self, label, **updates):
        self.read(lambda: label in self._controls)
        self.send("GuiUpdateMessage", uuid=self._controls[label], updates=updates)

    def upload(self, label):
        self.send(
            "FileTransferStartUpload", source_component_uuid=self._controls[label],
            transfer_uuid="1", filename="a", mime_type="a", part_count=0, size_bytes=0,
        )  # fmt: skip

    def drag(self, position, wxyz=(1.0, 0.0, 0.0, 0.0)):
        self.read(lambda: self.owner is not None)
        self.send("TransformControlsUpdateMessage", name="/target", owner=self.owner,
                  position=position, wxyz=wxyz)  # fmt: skip

    def close(self):
        self._socket.close()


@pytest.fixture
def server():
    with serving("kinfeas play") as server:
        yield server


@pytest.fixture
def join():
    """Return a function that opens the page of an address as a browser does."""
    clients = []

    def make(url, **identity):
        clients.append(Client(url, **identity))
        return clients[-1]

    yield make
    for client in clients:
        client.close()


@pytest.fixture
def make_page(server, tmp_path):
    pages = []

    def make(**changes):
        choice = Choice("pr2", **{"scene": "none", **changes})
        pages.append(PlayPage(server, choice, tmp_path / "demonstrations"))
        pages[-1].start()
        return pages[-1]

    yield make
    for page in pages:
        page.close()


def run_until(page, condition):
    for _ in range(1500):
        if condition():
            return
        page.run(0.04)
    raise AssertionError


def dragged(page, client, position):
    """Drag the handle, and wait until the page has read that and all earlier messages."""
    moved = threading.Event()

    @page.handle.on_update
    async def _(event):
        moved.set()

    client.drag(position)
    assert moved.wait(60.0)


def get(url, **headers):
    return urllib.request.urlopen(urllib.request.Request(url, headers=headers)).read().decode()


@pytest.mark.parametrize(("path", "headers"), [
    *(("", {"origin": url}) for url in ("https://evil.example", "null", "http://127.0.0.1:1")),
    ("", {"host": "evil.example"}),
    ("/?websocket=wss://evil.example", {}),
    ("/?playbackPath=https://evil.example/a.viser", {}),
    ("/index.html", {}),
])  # fmt: skip
def test_web_sites_get_neither_page_nor_websocket(server, join, path, headers):
    with pytest.raises(urllib.error.HTTPError, match="403"):
        get(server.url + path, **headers)
    with pytest.raises(InvalidStatus, match="403"):
        join(server.url + path, **headers)


def test_the_page_is_shown_with_its_title_but_in_no_frame(server, join, make_page):
    assert not make_page()._beside.visible  # there is one robot
    for url in (server.url, f"http://localhost:{server.get_port()}"):
        join(url)
        assert "<title>kinfeas: pr2</title>" in get(url)
    assert urllib.request.urlopen(server.url).headers["X-Frame-Options"] == "DENY"


def test_other_computers_need_the_token_of_the_address(join):
    with serving("kinfeas play", "0.0.0.0") as server:
        local, token = f"http://127.0.0.1:{server.get_port()}", server.url.rsplit("/", 1)[1]
        assert len(token) > 20
        for url in (local, f"{local}/{token[:-1]}"):
            with pytest.raises(urllib.error.HTTPError, match="403"):
                get(url)
            with pytest.raises(InvalidStatus, match="403"):
                join(url)
        for url in (f"{local}/{token}", f"{local}/{token}/"):
            assert "<title>kinfeas play</title>" in get(url)
            join(url).read(lambda: True)
        with pytest.raises(InvalidStatus, match="403"):
            join(f"{local}/{token}", host="evil.example")


def test_values_off_the_lists_change_nothing(server, join, make_page, tmp_path, monkeypatch):
    page, shared = make_page(), []
    monkeypatch.setattr(server, "request_share_url", lambda: shared.append(True))
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "off_the_list.py").write_text("def policy(robot): raise SystemExit")
    client, choice = join(server.url), page.choice
    for label in ("robot", "policy", "second policy", "generator", "backend", "scene"):
        for value in (
            "off_the_list:policy",
            "/etc/passwd",
            "ros2",
            "replay",
            "",
            None,
            ["none"],
            True,
        ):
            client.update(label, value=value)
        client.update(label, value="none", removed=True)
        client.update(label, update_cb=[])
        client.upload(label)
    client.update("feasibility", value="yes")
    client.send("ShareUrlRequest")
    target = page.target
    client.drag([np.nan, 0.0, 1.0])
    client.drag([1e300, 0.0, 1.0])
    client.drag([1.0, 0.0])
    client.drag([1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0])
    dragged(page, client, target[:3].tolist())
    page.run(0.2)
    np.testing.assert_allclose(page.target[:3], target[:3])
    assert page.choice == choice
    assert "off_the_list" not in sys.modules
    assert not shared
    client.update("policy", value="follow_ee")
    run_until(page, lambda: page.choice.policy == "follow_ee")


def test_a_port_in_use_is_an_error(server):
    port = server.get_port()
    with pytest.raises(KinfeasError, match=rf"{port}: .*use"), serving("kinfeas play", port=port):
        pass


def test_robots_of_two_policies_follow_the_handle_and_the_motion_is_saved(make_page, tmp_path):
    page = make_page(second_policy="follow_ee")
    assert page._beside.visible
    page.record()
    page.handle.position = page.handle.position + np.array([0.5, 0.3, 0.1])
    for _ in range(150):
        page.frame()
    page.record()
    for episode in page._episodes:
        assert distance(episode.ee_pose, page.target)[0] < 0.005
    saved = read_demonstration(tmp_path / "demonstrations" / "001.csv")
    assert saved.has_base
    assert np.ptp(saved.ee_pose[:, 0]) == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("change", [("Reset", True), ("generator", "linear")])
def test_a_change_saves_the_recording(server, join, make_page, tmp_path, change):
    page = make_page()
    page.record()
    for _ in range(10):
        page.frame()
    label, value = change
    join(server.url).update(label, value=value)
    saved = tmp_path / "demonstrations" / "001.csv"
    run_until(page, saved.exists)
    assert len(read_demonstration(saved).time) >= 20


def test_a_recording_is_kept_until_it_is_saved(server, join, make_page, tmp_path):
    page, client = make_page(), join(server.url)
    (tmp_path / "demonstrations").write_text("in the way")
    page.record()
    for _ in range(10):
        page.frame()
    page.record()
    client.read(lambda: any("demonstrations" in text for text in client.texts.values()))
    client.update("Reset", value=True)
    page.run(0.2)
    with pytest.raises(KinfeasError, match="demonstrations"):
        page.close()
    (tmp_path / "demonstrations").unlink()
    page.record()
    assert len(read_demonstration(tmp_path / "demonstrations" / "001.csv").time) == 20


@pytest.mark.parametrize("error", [KinfeasError("no such policy"), RuntimeError("a broken plugin")])
def test_the_error_of_a_choice_goes_with_it(server, join, make_page, monkeypatch, error):
    page, client = make_page(), join(server.url)
    monkeypatch.setattr("kinfeas.viz.live.Episode.__init__", Mock(side_effect=error))
    client.update("policy", value="follow_ee")
    run_until(page, lambda: str(error) in page._message.content)
    client.update("policy", value=page.choice.policy)
    run_until(page, lambda: page._message.content == "")


def test_garbage_closes_its_connection_and_is_one_line(server, join, caplog):
    client = join(server.url)
    client._socket.send(b"garbage")
    with pytest.raises(ConnectionClosed):
        client.read(lambda: False)
    (record,) = caplog.records
    assert record.exc_info is None
    assert "\n" not in record.getMessage()
