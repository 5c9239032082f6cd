"""The site: MyST pages by hand, reference and pictures made from the program at each build."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]
(HERE / "generated" / "static").mkdir(parents=True, exist_ok=True)

from docutils.utils.math.latex2mathml import tex2mathml  # noqa: E402

from modaltouch.system import version as modaltouch_version  # noqa: E402

project = "modaltouch"
author = "The modaltouch maintainers"
copyright = "the modaltouch maintainers; GPL-3.0-or-later"
version = release = modaltouch_version().partition("+")[0]

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist", "attrs_inline", "attrs_block"]
myst_heading_anchors = 4
exclude_patterns = ["requirements.lock", "generator", "examples"]
nitpicky = False
suppress_warnings = ["config.cache"]
smartquotes = False

autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
toc_object_entries = False
default_role = "code"

html_theme = "furo"
html_title = "modaltouch"
html_static_path = ["_static", "generated/static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0b5a8a", "color-brand-content": "#0b5a8a"},
    "dark_css_variables": {"color-brand-primary": "#7cc4f0", "color-brand-content": "#7cc4f0"},
}
pygments_style, pygments_dark_style = "a11y-high-contrast-light", "a11y-high-contrast-dark"
html_math_renderer = "mathml"


def write_formula(writer, node, block):
    """Write a formula as MathML, which browsers draw by themselves: no script, no font, no network."""
    writer.body.append(tex2mathml(node.astext(), as_block=block))
    from docutils.nodes import SkipNode

    raise SkipNode


def generate(app):
    """Write the pages and pictures that come from the program."""
    from generator import write_all

    write_all(HERE / "generated")


def setup(app):
    """Connect the generator and the renderer of formulas."""
    app.connect("builder-inited", generate)
    app.add_html_math_renderer(
        "mathml",
        (lambda writer, node: write_formula(writer, node, False), None),
        (lambda writer, node: write_formula(writer, node, True), None),
    )
    return {"parallel_read_safe": True}
