"""Builds the site: ``python -m sphinx -W --keep-going -n docs build/site``.

Sphinx, since the reference is made of docstrings and its links are checked; pages stay Markdown
(MyST), which people also read in the repository. Nothing is fetched, neither by the build nor by
the pages: equations are MathML, examples are run here, other sites' names are not linked.
"""

from __future__ import annotations

import sys
from pathlib import Path

_DOCS = Path(__file__).parent
sys.path.insert(0, str(_DOCS))

from build_steps import gallery, generated, rendering  # noqa: E402

import pincal  # noqa: E402

project = "pincal"
author = "pincal"
release = pincal.__version__
version = ".".join(release.split(".")[:2])
project_copyright = "pincal, BSD-3-Clause"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
templates_path = ["_templates"]
exclude_patterns = ["_build", "gallery/*.ipynb", "gallery/*.py", "gallery/*.md5"]
nitpicky = True
nitpick_ignore_regex = rendering.FOREIGN
suppress_warnings = ["config.cache"]

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4

autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
toc_object_entries_show_parents = "hide"
napoleon_numpy_docstring = False
napoleon_use_rtype = False
autosummary_generate = True
autosummary_ignore_module_all = False

sphinx_gallery_conf = gallery.settings(_DOCS)

html_theme = "pydata_sphinx_theme"
html_static_path = ["_static"]
html_extra_path = [str(generated.VIEW)]
html_search_scorer = str(_DOCS / "build_steps" / "search.js")
html_css_files = ["pincal.css"]
html_js_files = ["names.js"]
html_title = f"pincal {release}"
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_context = {"default_mode": "auto"}
html_sidebars = {"index": [], "start": [], "conventions": []}
html_theme_options = {
    "logo": {"text": f"pincal {release}"},
    "header_links_before_dropdown": 6,
    "navigation_depth": 3,
    "show_toc_level": 2,
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": {"**": ["page-toc"], "compare": []},
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True

# What is outside is checked by whoever has a network; links within the site by the build itself.
linkcheck_ignore = [r"https?://.*"]

gallery.stage(_DOCS)
generated.write(_DOCS)


def setup(app: object) -> None:
    """Add what Sphinx does not have: MathML, links to names where people import them."""
    rendering.setup(app)
