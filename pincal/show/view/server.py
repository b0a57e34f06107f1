"""One page served to this machine's browsers: loopback only, under its own name only."""

from __future__ import annotations

from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread


class PageServer:
    """Serves one page on a free port of 127.0.0.1 until it is closed.

    Requests under another host's name are refused, so that a page elsewhere whose name is made
    to resolve to this machine cannot read it.
    """

    def __init__(self, text: str) -> None:
        content = text.encode()

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                port = server.server_port
                if self.headers.get("Host") not in (f"127.0.0.1:{port}", f"localhost:{port}"):
                    self.send_error(HTTPStatus.MISDIRECTED_REQUEST, "not under this name")
                elif self.path.partition("?")[0] != "/":
                    self.send_error(HTTPStatus.NOT_FOUND)
                else:
                    self.send_response(HTTPStatus.OK)
                    self.send_header("Content-Type", "text/html; charset=utf-8")
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
