"""Sphinx configuration of the manual. `make docs` builds it into `service/manual`, from where the service serves it."""

import base64
import hashlib
import re
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

project = "Pointchain"
author = "The Pointchain authors"
release = PROJECT["version"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build"]
default_role = "code"
"""Docstrings write names in single backticks."""

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 4
"""Headings down to #### can be linked to, by the anchors that code forges give them."""
suppress_warnings = ["myst.xref_ambiguous"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "separated"
autodoc_default_options = {"members": True, "undoc-members": False, "exclude-members": "__init__, __new__"}
napoleon_google_docstring = True
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = "Pointchain manual"
html_favicon = "../service/console/web/icon.svg"
html_show_copyright = False
FONT = ROOT / "service/console/web/node_modules/@fontsource/stix-two-math"
"""The package of the font for equations, which `.ci/console` installs."""
html_static_path = ["_static", str(FONT / "files/stix-two-math-latin-400-normal.woff2")]
html_css_files = ["manual.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_sphinx = False
html_last_updated_fmt = None
templates_path = ["_templates"]
copybutton_exclude = ".linenos, .gp, .go"

html_math_renderer = "mathml"


def _inline_math(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(convert(node.astext()))
    raise nodes.SkipNode


def _display_math(translator: HTML5Translator, node: nodes.math_block) -> None:
    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    translator.body.append(f'<div class="math">{number}{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def _write_script_hashes(app: Sphinx, error: Exception | None) -> None:
    """Write the hashes of the theme's inline scripts, which the service's content policy allows by name."""
    if error is not None or app.builder.name != "html":
        return
    scripts = {
        script
        for page in Path(app.outdir).rglob("*.html")
        for script in re.findall(r"<script>(.*?)</script>", page.read_text(), re.DOTALL)
    }
    hashes = sorted(base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts)
    (Path(app.outdir) / "script-hashes.txt").write_text("".join(f"sha256-{value}\n" for value in hashes))


def _write_licences(app: Sphinx, error: Exception | None) -> None:
    """Write the licences of the packages whose scripts, style sheets and font are part of the built pages."""
    if error is not None or app.builder.name != "html":
        return
    texts = [
        f"{name}\n\n{file.read_text()}"
        for name in ("sphinx", "furo", "sphinx-copybutton")
        for file in metadata.files(name) or ()
        if file.name.startswith("LICENSE") and "dist-info" in str(file)
    ]
    texts.append(f"STIX Two Math\n\n{(FONT / 'LICENSE').read_text()}")
    (Path(app.outdir) / "licences.txt").write_text("\n---\n\n".join(texts))


def _let_keys_scroll(
    app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: nodes.document | None
) -> None:
    """Make code blocks and tables focusable: on a narrow screen they scroll, which must not need a pointer."""
    if "body" in context:
        context["body"] = re.sub(r'<(pre|div(?= class="table-wrapper))\b', r'<\1 tabindex="0"', context["body"])


def setup(app: Sphinx) -> None:
    """Register the MathML renderer and the list of inline scripts."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_display_math, None))
    app.connect("html-page-context", _let_keys_scroll)
    app.connect("build-finished", _write_script_hashes)
    app.connect("build-finished", _write_licences)
