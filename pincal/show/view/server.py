"""A page and its answers, served to this machine's browsers: loopback and its own name only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from urllib.parse import parse_qs, urlsplit


class PageServer:
    """Serves one page, and what it asks for, on a free port of 127.0.0.1 until it is closed.

    Requests under another host's name are refused, so that a page elsewhere whose name is made
    to resolve to this machine cannot read it.
    """

    def __init__(self, text: str, answer: Callable[[Mapping[str, list[str]]], str]) -> None:
        """Begin to serve.

        Args:
            text: The page.
            answer: Returns the JSON for the query of ``/moved``; a ValueError, KeyError or
                IndexError says that it is none.
        """

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                port = server.server_port
                if self.headers.get("Host") not in (f"127.0.0.1:{port}", f"localhost:{port}"):
                    self.send_error(HTTPStatus.MISDIRECTED_REQUEST, "not under this name")
                    return
                asked = urlsplit(self.path)
                if asked.path == "/":
                    self._send(text, "text/html")
                elif asked.path == "/moved":
                    try:
                        self._send(answer(parse_qs(asked.query)), "application/json")
                    except (ValueError, KeyError, IndexError):
                        self.send_error(HTTPStatus.BAD_REQUEST, "not a pose and how to move it")
                else:
                    self.send_error(HTTPStatus.NOT_FOUND)

            def _send(self, text: str, kind: str) -> None:
                content = text.encode()
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", f"{kind}; charset=utf-8")
                self.send_header("Content-Length", str(len(content)))
                self.send_header("Cache-Control", "no-store")
                self.send_header("X-Content-Type-Options", "nosniff")
                self.send_header("X-Frame-Options", "DENY")
                self.end_headers()
                with suppress(ConnectionError):  # the browser went away
                    self.wfile.write(content)

            def log_message(self, format: str, *args: object) -> None:  # noqa: A002
                pass

        server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{server.server_port}/"
        self._server = server
        self._thread = Thread(target=server.serve_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
