"""A real HTTP server that speaks chat completions, well or badly, as each test says."""

from __future__ import annotations

import gzip
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

Answer = Callable[[BaseHTTPRequestHandler, dict[str, Any]], None]


class Endpoint:
    def __init__(self, port: int, asked: list[dict[str, Any]]) -> None:
        self.url, self.asked = f"http://127.0.0.1:{port}/v1", asked


@contextmanager
def endpoint(*answers: Answer) -> Iterator[Endpoint]:
    """Gives the answers in turn, the last one for ever."""
    asked: list[dict[str, Any]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["content-length"])))
            asked.append({"path": self.path, "key": self.headers["authorization"], **body})
            answers[min(len(asked), len(answers)) - 1](self, body)

        def log_message(self, format: str, *args: Any) -> None: ...  # noqa: A002

        def handle_one_request(self) -> None:
            try:
                super().handle_one_request()
            except (BrokenPipeError, ConnectionResetError):
                self.close_connection = True

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    server.block_on_close = False
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
    try:
        yield Endpoint(server.server_address[1], asked)
    finally:
        server.shutdown()
        server.server_close()


def completion(
    text: str | None, *, refusal: str | None = None, finish_reason: str = "stop", model: str = "served-1"
) -> dict[str, Any]:
    message = {"role": "assistant", "content": text, "refusal": refusal}
    return {
        "id": "c1",
        "object": "chat.completion",
        "created": 1,
        "model": model,
        "choices": [{"index": 0, "message": message, "finish_reason": finish_reason, "logprobs": None}],
        "usage": {"prompt_tokens": 1, "completion_tokens": 1, "total_tokens": 2},
    }


def says(text: str | None, **more: Any) -> Answer:
    return body(json.dumps(completion(text, **more)).encode())


def body(content: bytes, *, status: int = 200) -> Answer:
    def answer(handler: BaseHTTPRequestHandler, asked: dict[str, Any]) -> None:
        _head(handler, len(content), status)
        handler.wfile.write(content)

    return answer


def error(status: int, message: str = "no") -> Answer:
    return body(json.dumps({"error": {"message": message, "type": "x"}}).encode(), status=status)


def silence(seconds: float) -> Answer:
    return lambda handler, asked: time.sleep(seconds)


def trickle(pause_s: float, *, status: int = 200) -> Answer:
    """A byte at a time, each well within any timeout between two bytes."""

    def answer(handler: BaseHTTPRequestHandler, asked: dict[str, Any]) -> None:
        content = json.dumps(completion("x" * 1000)).encode()
        _head(handler, len(content), status)
        for k in range(len(content)):
            handler.wfile.write(content[k : k + 1])
            handler.wfile.flush()
            time.sleep(pause_s)

    return answer


def slow_headers(pause_s: float) -> Answer:
    """The first line, then a header that never ends, a byte at a time."""

    def answer(handler: BaseHTTPRequestHandler, asked: dict[str, Any]) -> None:
        handler.wfile.write(b"HTTP/1.1 200 OK\r\nx-padding: ")
        while True:
            handler.wfile.write(b"a")
            handler.wfile.flush()
            time.sleep(pause_s)

    return answer


def echo(status: int, *, spelled: Callable[[str], str] = str) -> Answer:
    """Repeats the Authorization header, as endpoints do that say which key they do not know."""

    def answer(handler: BaseHTTPRequestHandler, asked: dict[str, Any]) -> None:
        key = spelled(handler.headers["authorization"])
        error(status, f"Incorrect API key provided: {key}.")(handler, asked)

    return answer


def refuses(parameter: str, *, then: Answer, named: bool = True) -> Answer:
    """HTTP 400 as long as ``parameter`` is sent; ``named``: in the error's own field too."""

    def answer(handler: BaseHTTPRequestHandler, asked: dict[str, Any]) -> None:
        if parameter not in asked:
            then(handler, asked)
            return
        entry = {"message": f"Unsupported: '{parameter}' with this model.", "param": parameter if named else None}
        body(json.dumps({"error": entry}).encode(), status=400)(handler, asked)

    return answer


def drop(after: int) -> Answer:
    """The connection ends after some bytes of the body; 0: before any of it."""

    def answer(handler: BaseHTTPRequestHandler, asked: dict[str, Any]) -> None:
        content = json.dumps(completion("never whole")).encode()
        if after:
            _head(handler, len(content), 200)
            handler.wfile.write(content[:after])
        handler.close_connection = True

    return answer


def flood(*, status: int = 200) -> Answer:
    def answer(handler: BaseHTTPRequestHandler, asked: dict[str, Any]) -> None:
        _head(handler, 1 << 40, status)
        while True:
            handler.wfile.write(b"a" * 65536)

    return answer


def bomb(size: int, *, status: int) -> Answer:
    """``size`` bytes of body, packed a thousandfold."""
    packed = gzip.compress(b"a" * size)

    def answer(handler: BaseHTTPRequestHandler, asked: dict[str, Any]) -> None:
        handler.send_response(status)
        handler.send_header("content-encoding", "gzip")
        handler.send_header("content-length", str(len(packed)))
        handler.end_headers()
        handler.wfile.write(packed)

    return answer


def redirect(to: str) -> Answer:
    def answer(handler: BaseHTTPRequestHandler, asked: dict[str, Any]) -> None:
        handler.send_response(307)
        handler.send_header("location", to)
        handler.send_header("content-length", "0")
        handler.end_headers()

    return answer


def _head(handler: BaseHTTPRequestHandler, length: int, status: int) -> None:
    handler.send_response(status)
    handler.send_header("content-type", "application/json")
    handler.send_header("content-length", str(length))
    handler.end_headers()
