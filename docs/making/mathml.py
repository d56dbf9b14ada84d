"""Formulas as MathML, by the converter that comes with docutils.

Every browser of today sets MathML by itself. So a page with formulas needs no script,
loads nothing, and prints; a bundle of MathJax would be 1.8 MB, in the repository or to
be fetched by every build.
"""

import html
import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml, pick_math_environment
from sphinx.util import logging

logger = logging.getLogger(__name__)


def setup(app: Any) -> dict[str, Any]:
    """Register the renderer with Sphinx."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def inline(writer: Any, node: Any) -> None:
    """A formula in a line."""
    writer.body.append(_made(node, block=False))
    raise nodes.SkipNode


def block(writer: Any, node: Any) -> None:
    """A formula that stands by itself, with its number where it has one."""
    writer.body.append(writer.starttag(node, "div", CLASS="math"))
    if node["number"]:
        writer.body.append(f'<span class="eqno">({node["number"]})</span>')
    writer.body.append(_made(node, block=True))
    writer.body.append("</div>\n")
    raise nodes.SkipNode


def _made(node: Any, block: bool) -> str:
    text = re.sub(r"\\dots\b", r"\\ldots", node.astext())
    if block and r"\begin{" not in text.strip()[:8]:
        name = pick_math_environment(text)
        if name != "equation*":
            text = rf"\begin{{{name}}}{text}\end{{{name}}}"
    try:
        return latex2mathml.tex2mathml(text, as_block=block)
    except MathError as error:
        logger.warning("formula: %s: %s", error, text, location=node)
        return f"<code>{html.escape(text)}</code>"
