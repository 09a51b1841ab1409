import json
import socket
import threading
import time
import urllib.error
import urllib.request
from contextlib import ExitStack, suppress

import pytest

from kinfeas.api.serve import PlanningServer

AHEAD = [1.0, 0.5, 0.8, 0.0, 0.0, 0.0, 1.0]
BOX = [1.0, 0.5, 0.0, 0.2, 0.2, 0.6, 1.0, 0.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def post():
    """Return a function that posts data, or bytes, and returns status and answer."""
    with PlanningServer("hsr", "room", 0) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
        thread.start()

        def send(path, data, **headers):
            body = data if isinstance(data, bytes) else json.dumps(data).encode()
            headers = {"Content-Type": "application/json", **headers}
            request = urllib.request.Request(server.url + path, body, headers)
            try:
                with urllib.request.urlopen(request) as answer:
                    return answer.status, json.load(answer)
            except urllib.error.HTTPError as error:
                return error.code, json.load(error)

        send.address, send.server = server.socket.getsockname(), server
        yield send
        server.shutdown()
        thread.join()


def test_base_poses_and_plans_are_answered(post):
    status, (answer,) = post("/reach", {"poses": [AHEAD], "k": 3})
    assert (status, len(answer["base_pose"]), answer["reason"]) == (200, 3, "")
    status, (answer,) = post("/reach", {"poses": [AHEAD], "solids": [BOX]})
    assert (status, answer["reachable"], answer["limit"]) == (200, False, "solids")
    path = [[1.0 + 0.01 * i, *AHEAD[1:]] for i in range(20)]
    status, answer = post("/plan", {"path": path})
    assert (status, len(answer["joint_trajectory"]["points"])) == (200, 20)
    status, answer = post("/plan", {"path": path, "solids": [BOX]})
    assert (status, "solid" in answer["error"]) == (400, True)


@pytest.mark.parametrize("method", ["GET", "PUT"])
def test_other_methods_are_errors(post, method):
    request = urllib.request.Request("http://{}:{}/".format(*post.address), method=method)
    with pytest.raises(urllib.error.HTTPError) as caught:
        urllib.request.urlopen(request)
    assert (caught.value.code, caught.value.headers["Allow"]) == (405, "POST")
    assert "POST /reach" in json.load(caught.value)["error"]


def test_a_slow_request_does_not_keep_others_waiting(post):
    with socket.create_connection(post.address) as slow:
        slow.sendall(b"POST /reach HTTP/1.1\r\nHost: 127.0.0.1\r\n")
        begin = time.monotonic()
        assert post("/reach", {"poses": [AHEAD]})[0] == 200
        assert time.monotonic() - begin < 5.0  # a request may take 10 s to arrive


HEAD = (
    b"POST /reach HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nContent-Type: application/json\r\n"
    b"Content-Length: 2\r\n\r\n"
)


def test_requests_of_clients_that_have_left_are_not_answered(post, monkeypatch):
    bodies = []
    monkeypatch.setitem(post.server.answers, "/reach", bodies.append)
    with post.server.lock, socket.create_connection(post.address) as gone:
        gone.sendall(HEAD % post.address[1] + b"{}")
        gone.close()
    post("/reach", [1])
    assert bodies == [[1]]


def test_a_body_that_stops_is_answered_with_408(post, monkeypatch):
    monkeypatch.setattr(post.server.RequestHandlerClass, "timeout", 0.3)
    with socket.create_connection(post.address) as slow:
        slow.sendall(HEAD % post.address[1] + b"{")
        assert b" 408 " in slow.makefile("rb").readline()


def test_connections_beyond_the_limit_are_answered_with_503(post):
    with ExitStack() as opened:
        many = [opened.enter_context(socket.create_connection(post.address)) for _ in range(40)]
        assert b" 503 " in many[-1].makefile("rb").readline()
    status = 503  # until the server has noticed that they are closed
    while status == 503:
        with suppress(ConnectionError):
            status, _ = post("/none", {})
    assert status == 404


@pytest.mark.parametrize(("short", "named"), [("solids", "yaw"), ("start", "3 entries")])
def test_short_lists_are_answered_with_what_is_missing(post, short, named):
    status, answer = post("/reach", {"poses": [AHEAD], short: [[1]] if short == "solids" else [1]})
    assert (status, answer["error"].count(named)) == (400, 1)
    assert " 2 entries" not in answer["error"]


@pytest.mark.parametrize(("path", "data", "headers", "status"), [
    ("/reach", {"poses": [AHEAD]}, {"Origin": "http://example.org"}, 403),
    ("/reach", {"poses": [AHEAD]}, {"Host": "example.org"}, 403),
    ("/reach", {"poses": [AHEAD]}, {"Content-Type": "text/plain"}, 415),
    ("/reach", b"{}", {"Content-Length": "4000001"}, 413),
    ("/reach", b"{}", {"Content-Length": "9" * 5000}, 413),
    ("/none", {"poses": [AHEAD]}, {}, 404),
    ("/reach", b'{"poses": [' + b"1," * 400_000 + b"1]}", {}, 400),
    ("/reach", b"{", {}, 400),
    ("/reach", {"poses": [AHEAD], "robot": "pr2"}, {}, 400),
    ("/reach", {"poses": [AHEAD], "scene": "/etc/passwd"}, {}, 400),
    ("/reach", {"poses": [[float("nan"), *AHEAD[1:]]]}, {}, 400),
    ("/reach", {"poses": [AHEAD], "solids": [[1, 2]]}, {}, 400),
    ("/reach", {"poses": [AHEAD], "solids": [[*BOX[:7], 0.5, 0, 0, 0]]}, {}, 400),
    ("/reach", {"poses": [AHEAD], "solids": [BOX] * 65}, {}, 400),
    ("/reach", {"poses": [AHEAD], "solids": [[1, 0, 0, -1, 1, 0, 1, 0, 0, 0, 0]]}, {}, 400),
    ("/reach", {"poses": [AHEAD], "solids": [[1, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0]]}, {}, 400),
    ("/reach", {"poses": [AHEAD], "start": [9000, 9000, 0]}, {}, 400),
    ("/reach", {"poses": [AHEAD] * 126, "k": 512}, {}, 400),
    ("/plan", {"path": [AHEAD]}, {}, 400),
    ("/plan", {"path": [AHEAD, AHEAD], "joints": [0.0], "start": [0, 0, 0]}, {}, 400),
])  # fmt: skip
def test_other_requests_are_errors(post, path, data, headers, status):
    answer = post(path, data, **headers)
    assert answer[0] == status
    assert answer[1]["error"]


def test_errors_are_in_plain_words(post):
    assert "'poses': must be a list of 1 or more" in post("/reach", {"poses": []})[1]["error"]
