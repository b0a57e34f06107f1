"""Follows every link within a built site: ``python -m tools.links build/site``.

A page that is not there, a file, a picture, or a heading: each is said with the page that links to
it, and the exit code is 1. Links to other sites are counted, not followed.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from urllib.parse import unquote, urlsplit

from lxml import html


@cache
def _page(path: Path) -> html.HtmlElement:
    return html.fromstring(path.read_bytes())


@cache
def _anchors(path: Path) -> frozenset[str]:
    page = _page(path)
    return frozenset([*page.xpath("//@id"), *page.xpath("//a/@name")])


def broken(site: Path) -> tuple[list[str], int, int]:
    """Return what is broken in a site, how many links lead within it, and how many outside."""
    wrong, inside, outside = [], 0, 0
    for path in sorted(site.rglob("*.html")):
        if "_static" in path.parts:
            continue
        for link in _page(path).xpath("//@href | //@src"):
            parts = urlsplit(link)
            if parts.scheme in ("http", "https", "mailto", "data"):
                outside += parts.scheme.startswith("http")
                continue
            inside += 1
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            where = str(path.relative_to(site))
            if not target.exists():
                wrong.append(f"{where}: {link}: no such file")
            elif (
                parts.fragment
                and target.suffix == ".html"
                and unquote(parts.fragment) not in _anchors(target)
            ):
                wrong.append(f"{where}: {link}: no such heading")
    return list(dict.fromkeys(wrong)), inside, outside


def main(site: Path) -> int:
    """Print what is broken, and the site's size; return the exit code."""
    wrong, inside, outside = broken(site)
    size = sum(path.stat().st_size for path in site.rglob("*") if path.is_file())
    pages = len(list(site.rglob("*.html")))
    print(*wrong, sep="\n", end="\n" if wrong else "")
    print(
        f"{pages} pages, {size / 1e6:.1f} MB; {inside} links within, {len(wrong)} broken;", end=" "
    )
    print(f"{outside} links to other sites, not followed")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
