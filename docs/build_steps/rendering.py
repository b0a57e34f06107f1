"""How the site renders what Sphinx leaves to JavaScript or to other sites.

Equations become MathML, which browsers draw without a script. A name in a signature is linked to
the place where people import it: ``pincal.model.mechanism.Mechanism`` is ``pincal.Mechanism``.
"""

from __future__ import annotations

import html
import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging

import pincal

#: Names that no page of this site has: other packages', type variables, and aliases of arrays.
FOREIGN = [
    (r"py:.*", r"(np|numpy|scipy|typing|collections|pathlib|matplotlib|os|types)\..*"),
    (
        r"py:.*",
        r"(Array|ArrayLike|Axes|Figure|Path|NDArray|Any|Callable|Iterable|Iterator|Literal)",
    ),
    (r"py:.*", r"pincal(\.[a-z_]+)+\.[A-Z]\w+"),  # inner types that calls neither take nor return
    (r"py:.*", r"(Calibration|Outlier|External|Plots|Report)"),
    (r"py:.*", r"(Mapping|Sequence|Self|Generator|optional|array|bool|int|float|str)"),
]
_BARE = re.compile(r"(``.*?``)|\|")


def mathml(node: nodes.math | nodes.math_block, as_block: bool = False) -> str:
    """Return an equation as MathML; one that cannot be is a warning, and stays as it is typed."""
    try:
        return str(tex2mathml(node.astext(), as_block=as_block))
    except MathError as error:
        logging.getLogger(__name__).warning(str(error), location=node)
        return html.escape(node.astext())


def _math(self: Any, node: nodes.math) -> None:
    self.body.append(mathml(node))
    raise nodes.SkipNode


def _equation(self: Any, node: nodes.math_block) -> None:
    self.body.append(f'<div class="equation">{mathml(node, as_block=True)}</div>')
    raise nodes.SkipNode


def where_imported(app: Any, env: Any, node: Any, contnode: Any) -> Any:
    """Return a link to a public name that was called by the module that holds it."""
    name = node.get("reftarget", "").split(".")
    if node.get("refdomain") != "py":
        return None
    public = [one for one in name if one in pincal.__all__]
    target = ".".join(["pincal", *name[name.index(public[0]) :]]) if public else ""
    if not public or target == node["reftarget"]:
        return None
    domain = env.get_domain("py")
    return domain.resolve_xref(
        env, node["refdoc"], app.builder, node["reftype"], target, node, contnode
    )


def as_written(_: Any, what: str, __: str, ___: Any, ____: Any, lines: list[str]) -> None:
    """Let |values| stay as they are, and attributes' docstrings begin with no type.

    Napoleon takes what stands before a colon for an attribute's type, and docutils what stands
    between bars for a substitution.
    """
    lines[:] = [_BARE.sub(lambda one: one[0] if one[1] else r"\|", line) for line in lines]
    if what in ("attribute", "property"):
        lines[:0] = ["..", ""]  # an empty comment


def links_within(_: Any, __: str, source: list[str]) -> None:
    """Lead links to the repository's top and examples to the pages that the site has of them."""
    text = re.sub(r"\]\(\.\./((?:\.\./)*)examples/(\w+)\.py\)", r"](\1gallery/\2.rst)", source[0])
    text = re.sub(r"\]\(\.\./((?:\.\./)*)examples/?\)", r"](\1gallery/index.rst)", text)
    top = r"\]\(\.\./((?:\.\./)*)(CONTRIBUTING|CHANGELOG)\.md\)"
    source[0] = re.sub(top, lambda one: f"]({one[1]}reference/made/{one[2].lower()}.md)", text)


def setup(app: Any) -> None:
    """Register the renderer and the resolver with a Sphinx application."""
    app.add_html_math_renderer("mathml", (_math, None), (_equation, None))
    app.connect("missing-reference", where_imported)
    app.connect("source-read", links_within)
    app.connect("autodoc-process-docstring", as_written, priority=400)
