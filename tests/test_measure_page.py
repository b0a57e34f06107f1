"""The page of a session: in a real browser by keyboard and clicks, two at once, and refused."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import urlsplit

import pytest
from bench import NOISE, Bench

import pincal
from pincal.calibration.session import Session, SessionOptions
from pincal.files.journal import Journal
from pincal.show.measuring import responding, state, version
from pincal.show.view.view import PageServer

AXE = Path(__file__).parents[1] / "node_modules" / "axe-core" / "axe.min.js"


@pytest.fixture(scope="module")
def bench() -> Bench:
    """Return a five-bar with 20 poses that it reaches."""
    mechanism = pincal.load_mechanism("5R")
    return Bench(mechanism, pincal.sample_configurations(mechanism, 20, 3))


@pytest.fixture
def session(bench: Bench, tmp_path: Path) -> Session:
    """Return a session of 10 rows of 20."""
    options = SessionOptions(noise=NOISE, accuracy=1e-5)
    opened = Session(Journal(tmp_path / "s"), bench.mechanism, bench.plan, options)
    for _ in range(10):
        opened.add(bench.entry(opened.columns, opened.next_pose()[0]))
    return opened


@pytest.fixture
def server(session: Session) -> Iterator[PageServer]:
    """Return the server of its page."""
    server = PageServer(responding(session, None, Lock()))
    yield server
    server.close()


def asked(url: str, path: str, posted: Any = None, **headers: str) -> tuple[int, str]:
    """Return status and text of an answer, as another program gets it."""
    place = urlsplit(url)
    connection = http.client.HTTPConnection("127.0.0.1", place.port or 0)
    body = None if posted is None else json.dumps(posted)
    connection.request("GET" if body is None else "POST", path, body, headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


def test_foreign_hosts_and_origins_are_refused(server: PageServer, session: Session) -> None:
    """Nothing is read under another's name, nothing written from another's page."""
    order = {"line": "u", "row": 0, "version": version(session)}
    assert asked(server.url, "/state", Host="elsewhere.example")[0] == 421
    assert asked(server.url, "/state", order, Origin="http://elsewhere.example")[0] == 403
    assert asked(server.url, "/state", order, Origin="null")[0] == 403
    faulty = ("no order", {**order, "line": 5}, {**order, "row": 9999}, {**order, "row": "a"})
    for posted in (*faulty, json.loads("[" * 900 + "]" * 900)):
        assert asked(server.url, "/state", posted)[0] == 400
    for row in ("-1", "9999", "a"):
        assert asked(server.url, f"/picture?row={row}")[0] == 400
    assert asked(server.url, "/other")[0] == 404
    assert len(session.journal.rows) == 10
    status, text = asked(server.url, "/state", order, Origin=server.url.rstrip("/"))
    assert status == 200
    assert json.loads(text)["count"] == len(session.journal.rows) == 9


def test_two_windows_lose_nothing(server: PageServer, session: Session, bench: Bench) -> None:
    """Of two that post what they see at once one is recorded, the other told so."""
    seen = json.loads(asked(server.url, "/state")[1])
    line = bench.line(session.columns, seen["row"] - 1)
    order = {"line": line, "row": seen["row"] - 1, "version": seen["version"]}
    first, second = (json.loads(asked(server.url, "/state", order)[1]) for _ in range(2))
    assert (first["count"], first["trouble"]) == (11, "")
    assert second["count"] == 11
    assert "changed in another window" in second["trouble"]
    wrong = {**order, "version": second["version"], "line": "1 2 3 4 5 6 7"}
    refused = json.loads(asked(server.url, "/state", wrong)[1])
    assert refused["count"] == 11
    assert refused["trouble"].startswith("'1 2 3 4 5 6 7' is no row: expected x [mm], y [mm]")


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1200])
def test_rows_are_entered_by_keyboard_and_clicks(
    width: int, browser: Any, server: PageServer, session: Session, bench: Bench
) -> None:
    """Typed, pasted, off, undone, kept, skipped; nothing is wider than the screen, axe is clean."""
    context = browser.new_context(viewport={"width": width, "height": 800}, bypass_csp=True)
    page, said = context.new_page(), []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(server.url)

    def recorded(count: int) -> None:
        page.wait_for_function(
            "(n) => document.querySelector('#count').textContent === n", arg=f"{count} measured"
        )

    def cells() -> list[str]:
        return list(bench.entry(session.observed, session.next_pose()[0]).values())

    recorded(10)
    page.wait_for_timeout(2500)  # what is typed stays while the page looks for news
    for cell in cells():
        page.keyboard.type(cell)
        page.keyboard.press("Enter")
    recorded(11)
    assert page.inner_text("#verdict").startswith("row 11 is recorded: ")
    wrong = [str(float(cells()[0]) + 1.0), *cells()[1:]]
    for place, cell in enumerate(wrong):
        page.locator("#observed input").nth(place).fill(cell)
    page.click("text=record")
    page.wait_for_selector("#off:not([hidden])")
    assert "σ off" in page.inner_text("#off p")
    page.keyboard.press("u")
    recorded(10 + 1)
    page.wait_for_selector("#off[hidden]", state="attached")
    for place, cell in enumerate(wrong):
        page.locator("#observed input").nth(place).fill(cell)
    page.keyboard.press("Enter")
    page.wait_for_selector("#off:not([hidden])")
    page.click("[data-line=k]")
    page.wait_for_selector("#off[hidden]", state="attached")
    recorded(12)
    row = state(session)["row"]
    page.click("text=skip this pose")
    page.wait_for_function(
        f"!document.querySelector('#next').textContent.startsWith('pose {row} ')"
    )
    page.click("#undo")
    recorded(11)
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert page.locator("#chart circle").count() == 5  # no limit while unknowns are more
    page.click("text=parameters")
    assert "leg_1" in page.inner_text("#parameters")
    if AXE.is_file():
        page.evaluate(AXE.read_text("utf-8"))
        assert page.evaluate("async () => (await axe.run()).violations.map((v) => v.id)") == []
    assert said == []
    context.close()
