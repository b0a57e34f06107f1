"""``pincal.view``: the same page of a mechanism in the browser, in a file, or in a notebook.

``PageServer`` serves it to this machine alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from http import HTTPStatus
from pathlib import Path
from threading import Event, Thread
from urllib.parse import parse_qsl, urlsplit
from weakref import finalize

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from pincal.calibration.result import CalibrationResult
from pincal.errors import WorkspaceError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.configurations import home_of
from pincal.model import Plan
from pincal.show.answers import warnings
from pincal.show.report import Page
from pincal.show.view.meshes import with_meshes
from pincal.show.view.page import answer, page
from pincal.show.view.scene import Scene, calibrated, scene
from pincal.workspace.sampling import sample_configurations

_LONGEST = 100_000  # most bytes of a posted text
PATIENCE = 10.0  # seconds in which a client must send its request, and take the answer


class View(Page):
    """A view of a mechanism: a page to open, to save, or to see in a notebook.

    At its ``url`` the mechanism can be moved to other poses; a saved page shows its poses only.
    """

    sandbox, height = "allow-scripts allow-downloads", "600px"

    def __init__(self, scene: Scene, notices: Sequence[str] = ()) -> None:
        self.scene, self._notices = scene, tuple(notices)

    def with_meshes(self, urdf: str | Path) -> View:
        """Return the view with meshes on an arm's links, from the URDF that it was read from.

        Raises:
            FileError: the URDF or a mesh cannot be read, or the URDF has other joints.
            MechanismError: the URDF is not well formed.
        """
        scene, mechanism = self.scene, self.scene.mechanism
        body = with_meshes(scene.body, mechanism, urdf)
        magnified = scene.magnified and with_meshes(scene.magnified, mechanism, urdf)
        return View(replace(scene, body=body, magnified=magnified), self._notices)

    def with_result(self, result: CalibrationResult) -> View:
        """Return the view with the results of a calibration of this mechanism.

        It has arrows from measured to predicted points, the places of instruments, and warnings.
        """
        return View(calibrated(self.scene, result), warnings(result))

    @cached_property
    def _page(self) -> str:
        return page(self.scene, self._notices)

    @cached_property
    def url(self) -> str:
        """Address of the page for browsers on this machine, until ``close`` or the process ends."""
        server = PageServer(responding(self.scene, page(self.scene, self._notices, served=True)))
        self._close = finalize(self, server.close)
        return server.url

    def close(self) -> None:
        """Stop serving the page, if it was asked for by ``url``."""
        if self.__dict__.pop("url", None):
            self._close()


def view(
    mechanism: GivenMechanism,
    poses: Plan | ArrayLike | RigidTransform | None = None,
    *,
    identified: GivenMechanism | None = None,
    magnify: float | None = None,
) -> View:
    """Return a view of a mechanism at poses: ``url``, ``save(path)``, or shown by a notebook.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: A plan or measurements, coordinates of shape (N, dof), [m] and [rad], or
            transforms; home and some of the workspace if not given. At most 2000.
        identified: The calibrated mechanism, shown as the readings of the nominal one drive it.
        magnify: Factor on the differences between identified and nominal parameters; if not given,
            one that makes errors visible and lets the mechanism assemble at every pose.

    Raises:
        MechanismError: poses have a wrong shape or are not finite; ``identified`` is another
            mechanism.
        MeasurementError: there are no poses, too many or incomplete ones; or ``magnify`` <= 0.

    Example:
        >>> import pincal
        >>> page = pincal.view("5R", [[0.0, 1.1]])
        >>> page.html().startswith("<!DOCTYPE html>")
        True
    """
    mechanism = as_mechanism(mechanism)
    if poses is None:
        plans = [home_of(mechanism)]
        with suppress(WorkspaceError):  # no workspace with the default margins
            plans.append(sample_configurations(mechanism, 24))
        read = [plan.readings for plan in plans if plan.readings is not None]
        readings = np.concatenate(read) if read else None
        poses = Plan(np.concatenate([plan.poses for plan in plans]), readings=readings)
    return View(scene(mechanism, poses, identified, magnify))


Respond = Callable[[str, Mapping[str, str], str], tuple[str, str | bytes] | None]
"""Function of path, query and posted text (empty if none) that returns content type and content,
None for an unknown path. For a faulty request it raises ValueError, LookupError or TypeError."""


def responding(scene: Scene, text: str) -> Respond:
    """Return the handler that serves the page of a scene, and the scene at moved poses."""

    def respond(path: str, query: Mapping[str, str], posted: str) -> tuple[str, str] | None:
        if path == "/" and not posted:
            return "text/html", text
        if path != "/moved" or posted:
            return None
        row = range(len(scene.plan.poses)).index(int(query["row"]))
        return "application/json", answer(scene, row, np.array(query["by"].split(","), float))

    return respond


class PageServer:
    """Server of pages on a free port of 127.0.0.1 until it is closed.

    One thread serves all clients, however many of them stay silent. Requests under another host's
    name, or from another host's page, are refused, so that a foreign page whose name resolves to
    this machine (DNS rebinding) can neither read nor write.
    """

    def __init__(self, respond: Respond) -> None:
        """Start serving."""
        self._respond = respond
        self._listening = Event()
        self._thread = Thread(target=lambda: asyncio.run(self._run()), daemon=True)
        self._thread.start()  # in a notebook the main thread already runs a loop
        self._listening.wait()

    async def _run(self) -> None:
        """Listen until the server is closed; pending requests end with the loop."""
        self._loop, self._closed = asyncio.get_running_loop(), asyncio.Event()
        self._loop.set_exception_handler(lambda *_: None)  # clients that hang up
        try:
            server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
            port = server.sockets[0].getsockname()[1]
            self._hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
            self.url = f"http://{self._hosts[0]}/"
        finally:
            self._listening.set()
        await self._closed.wait()
        server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer a client's request, or hang up if none comes."""
        try:
            request = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), PATIENCE)
            first, *lines = request.decode("latin-1").splitlines()
            parts = (line.partition(":") for line in lines)
            headers = {name.lower(): value.strip() for name, _, value in parts}
            length = min(int("0" + headers.get("content-length", "")), _LONGEST)
            posted = await asyncio.wait_for(reader.readexactly(length), PATIENCE)
            status, kind, content = self._response(first, headers, posted.decode())
            head = (
                f"HTTP/1.0 {status.value} {status.phrase}",
                f"Content-Type: {kind}; charset=utf-8",
                f"Content-Length: {len(content)}",
                "Cache-Control: no-store",
                "X-Content-Type-Options: nosniff",
                "X-Frame-Options: DENY",
            )
            writer.write("\r\n".join((*head, "\r\n")).encode() + content)
            await asyncio.wait_for(writer.drain(), PATIENCE)
        except (OSError, ValueError, TimeoutError, EOFError, asyncio.LimitOverrunError):
            pass  # the client went away, or sent no request
        finally:
            writer.close()

    def _response(
        self, first: str, headers: Mapping[str, str], posted: str
    ) -> tuple[HTTPStatus, str, bytes]:
        """Return status, content type and content of the answer to a request."""
        method, target, *_ = [*first.split(" "), "", ""]
        address, host = urlsplit(target), headers.get("host")
        if method not in ("GET", "POST"):
            return HTTPStatus.NOT_IMPLEMENTED, "text/plain", b"only GET and POST"
        if host not in self._hosts:
            return HTTPStatus.MISDIRECTED_REQUEST, "text/plain", b"not under this name"
        if headers.get("origin", f"http://{host}") != f"http://{host}":
            return HTTPStatus.FORBIDDEN, "text/plain", b"not from another's page"
        try:
            answered = self._respond(address.path, dict(parse_qsl(address.query)), posted)
        except (ValueError, LookupError, TypeError, RecursionError):
            return HTTPStatus.BAD_REQUEST, "text/plain", b"not what this page asks for"
        if answered is None:
            return HTTPStatus.NOT_FOUND, "text/plain", b"no such page"
        kind, content = answered
        return HTTPStatus.OK, kind, content.encode() if isinstance(content, str) else content

    def close(self) -> None:
        """Stop serving."""
        self._loop.call_soon_threadsafe(self._closed.set)
        self._thread.join()
