"""Settings of Sphinx; `make docs` builds the pages into build/docs, and warnings are errors."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent))

import pages_from_code
import pictures_from_code

import fopid_core

project = "fopid"
author = "the fopid developers"
release = version = fopid_core.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
exclude_patterns = ["generated/README.md"]
myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 3
nitpicky = False

html_theme = "furo"
html_title = f"fopid {release}"
html_copy_source = False
html_show_copyright = False

autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_rtype = False


def _bars_are_no_substitutions(*hook: Any) -> None:
    """Docstrings write |S| for a magnitude, which reStructuredText would look up as a substitution."""
    lines = hook[-1]
    lines[:] = [re.sub(r"(``.*?``)|\|", lambda found: found[1] or r"\|", line) for line in lines]


def _write_pages(app: Sphinx) -> None:
    pages_from_code.write(Path(app.srcdir) / "generated")
    pictures_from_code.write(Path(app.srcdir) / "generated")


def setup(app: Sphinx) -> None:
    """Write what comes from the code, before the pages are read."""
    app.connect("builder-inited", _write_pages)
    app.connect("autodoc-process-docstring", _bars_are_no_substitutions)
