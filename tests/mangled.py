"""Files as accidents and attackers leave them: strategies that mangle bytes of a sound file."""

from __future__ import annotations

import re

from hypothesis import strategies as st

#: What stands where a number should: not finite, beyond doubles, of other tongues and notations.
ODD = [
    *("inf", "-inf", "nan", ".nan", ".inf", "1e400", "-1e308", "1e308", "1e-320", "1e12", "-0.0"),
    *("1,5", "１", "1_0", "010", "0x1p3", "1:30", "1e", "+-1", "1.5.2", "--", "", " ", "9" * 400),
    *("9" * 5000, "\xa01", "1\xa0", "true", "null", "~", "0", "-1", "1e-9", "1e6", "[1]", "home"),
    *("b_1", "platform", "leg_1_base", "1/0", "'1'", '"1"', "1e5", "2001-01-01", "!!int 1"),
]
#: Pieces that mean something to a parser, or nothing to any.
PIECES = [
    *(b"\0", b"\xef\xbb\xbf", b"\xff\xfe", b"\r", b"\n", b"\r\n", b"\t", b"\x1b[2J", b"\xc3"),
    *("\u2028".encode(), "\x85".encode(), "é".encode(), "é".encode("latin-1"), b"\xed\xa0\x80"),
    *(b"[", b"]", b"{", b"}", b"<", b">", b"&", b"'", b'"', b":", b": ", b"- ", b"#", b",", b";"),
    *(b"*a", b"&a ", b"!!python/name:os.system ", b"!!set {a}", b"? ", b"<<: ", b"%YAML 9\n", b"|"),
    *(
        b"---\n",
        b"...\n",
        b"<!-- ",
        b"-->",
        b"<?xml version='1.0' encoding='utf-16'?>",
        b"<![CDATA[",
    ),
    *(
        b"&lt;",
        b"&#0;",
        b"&x;",
        b"[DEFAULT]\n",
        b"[include *]\n",
        b"[include /dev/zero]\n",
        b"#*# ",
    ),
    *(b"M665 L1 R1 H1\n", b"M666 A0", b"(", b")", b"N1 ", b"=", b"\\", b'"\\ud800"', b"\x0c"),
]
NESTS = [b"[", b"{a: ", b"- ", b"? ", b'{"a":', b"<a>", b"<joint><a>", b"(", b'"', b"\n ", b"&#"]
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:e-?\d+)?")
_WORD = re.compile(rb"[\w.+-]+")


@st.composite
def mangled(draw: st.DrawFn, sound: bytes) -> bytes:
    """Return a sound file after one to four accidents, or bytes that never were one."""
    if draw(st.integers(0, 19)) == 0:
        return draw(st.binary(max_size=300))
    data = sound
    for _ in range(draw(st.integers(1, 4))):
        data = _accident(draw, data)
    return data


def _accident(draw: st.DrawFn, data: bytes) -> bytes:
    """Return bytes after one accident."""
    kind = draw(st.sampled_from([*_KINDS, "number", "number", "number"]))
    return _KINDS[kind](draw, data) if data else data


def _place(draw: st.DrawFn, data: bytes) -> int:
    return draw(st.integers(0, len(data)))


def _flip(draw: st.DrawFn, data: bytes) -> bytes:
    at = draw(st.integers(0, len(data) - 1))
    return data[:at] + bytes([data[at] ^ (1 << draw(st.integers(0, 7)))]) + data[at + 1 :]


def _cut(draw: st.DrawFn, data: bytes) -> bytes:
    start = _place(draw, data)
    return data[:start] + data[start + draw(st.integers(1, 200)) :]


def _end(draw: st.DrawFn, data: bytes) -> bytes:
    return data[: _place(draw, data)]


def _insert(draw: st.DrawFn, data: bytes) -> bytes:
    at = _place(draw, data)
    return data[:at] + draw(st.sampled_from(PIECES) | st.binary(max_size=8)) + data[at:]


def _nest(draw: st.DrawFn, data: bytes) -> bytes:
    at, deep = _place(draw, data), draw(st.sampled_from([10, 500, 3000]))
    return data[:at] + draw(st.sampled_from(NESTS)) * deep + data[at:]


def _lines(draw: st.DrawFn, data: bytes) -> bytes:
    """Return the file with a line repeated, moved, left out or exchanged for another."""
    lines = data.splitlines(keepends=True)
    places = st.integers(0, len(lines) - 1)
    first, second = draw(places), draw(places)
    how = draw(st.sampled_from(["twice", "exchanged", "without", "again"]))
    if how == "twice":
        lines.insert(first, lines[first])
    elif how == "exchanged":
        lines[first], lines[second] = lines[second], lines[first]
    elif how == "without":
        del lines[first]
    else:
        lines.insert(second, lines[first])
    return b"".join(lines)


def _number(draw: st.DrawFn, data: bytes) -> bytes:
    return _exchanged(draw, data, _NUMBER, draw(st.sampled_from(ODD)).encode())


def _word(draw: st.DrawFn, data: bytes) -> bytes:
    words = sorted(set(_WORD.findall(data)))
    return _exchanged(draw, data, _WORD, draw(st.sampled_from(words))) if words else data


def _exchanged(draw: st.DrawFn, data: bytes, pattern: re.Pattern[bytes], new: bytes) -> bytes:
    """Return the file with one match of a pattern exchanged."""
    found = list(pattern.finditer(data))
    if not found:
        return data
    one = draw(st.sampled_from(range(len(found))))
    return data[: found[one].start()] + new + data[found[one].end() :]


def _encode(draw: st.DrawFn, data: bytes) -> bytes:
    """Return the file in another encoding, or part of it."""
    how = draw(st.sampled_from(["utf-16", "utf-32", "latin-1", "cp1252", "utf-8-sig", "half"]))
    text = data.decode("utf-8", "replace")
    if how == "half":
        half = len(text) // 2
        return text[:half].encode("utf-8", "replace") + text[half:].encode("utf-16-le", "replace")
    return text.encode(how, "replace")


def _ends(draw: st.DrawFn, data: bytes) -> bytes:
    return data.replace(b"\n", draw(st.sampled_from([b"\r\n", b"\r", b"\n\n", b"\n\r"])))


_KINDS = {
    "flip": _flip,
    "cut": _cut,
    "end": _end,
    "insert": _insert,
    "nest": _nest,
    "lines": _lines,
    "number": _number,
    "word": _word,
    "encode": _encode,
    "ends": _ends,
}
