"""What a server says of its health, and what is no mistake."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from carecontact.contract.policy_ref import PolicyRef
from carecontact.trials.deep.health import health


@contextmanager
def answering(pages: dict[str, tuple[int, bytes]]) -> Iterator[int]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            status, text = pages.get(self.path, (404, b"nothing here"))
            self.send_response(status)
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, *args: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.parametrize(
    ("scheme", "path"),
    [("openpi", "/healthz"), ("roboarena", "/healthz"), ("roboarena", "/health"), ("vla-eval", "/health")],
)
def test_a_healthy_server(scheme: str, path: str) -> None:
    with answering({path: (200, b"OK\n")}) as port:
        found = health(PolicyRef.parse(f"{scheme}://127.0.0.1:{port}"))
    assert found is not None
    assert (found.level, found.text) == ("ok", f"{path} answers OK")


def test_a_sick_server() -> None:
    with answering({"/healthz": (503, b"loading \x1b[31m")}) as port:
        found = health(PolicyRef.parse(f"openpi://127.0.0.1:{port}"))
    assert found is not None
    assert (found.level, found.text) == ("warning", "/healthz answers HTTP 503 loading \\x1b[31m")


def test_no_such_address_and_no_server_are_no_mistake() -> None:
    with answering({}) as port:
        assert health(PolicyRef.parse(f"vla-eval://127.0.0.1:{port}")) is None
    assert health(PolicyRef.parse("openpi://127.0.0.1:9")) is None
    assert health(PolicyRef.parse("ws://127.0.0.1:9")) is None
    assert health(PolicyRef.parse("hover")) is None
