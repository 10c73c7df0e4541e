"""Equations as MathML, which browsers draw themselves: no script, no network."""

from __future__ import annotations

from typing import Any

from latex2mathml.converter import convert


def setup(app: Any) -> dict[str, bool]:
    """Registers the renderer ``mathml`` with Sphinx."""
    app.add_html_math_renderer("mathml", (inline, None), (display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def inline(page: Any, node: Any) -> None:
    """Writes an equation in a line of text."""
    write(page, node, "inline")


def display(page: Any, node: Any) -> None:
    """Writes an equation of its own, with its number if it has one."""
    write(page, node, "block")


def write(page: Any, node: Any, kind: str) -> None:
    """Writes an equation and skips its text."""
    from docutils.nodes import SkipNode

    page.body.append(convert(node.astext(), display=kind))
    raise SkipNode
