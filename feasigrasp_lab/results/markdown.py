"""Markdown output of commands."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Mapping, Sequence


def markdown_table(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table; every line has as many cells as ``heads``."""
    rows = [list(heads), ["---"] * len(heads), *map(list, lines)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


def markdown_html(text: str, images: Mapping[str, str]) -> str:
    """The Markdown that commands write, as HTML: headings, tables, images, code, bold, text.

    Args:
        text: The Markdown.
        images: What stands for an image in the page, by its name in the text.
    """
    return "\n".join(_block_html(block, images) for block in text.strip().split("\n\n"))


def _block_html(block: str, images: Mapping[str, str]) -> str:
    if heading := re.fullmatch(r"(#+) (.*)", block):
        level = len(heading[1])
        return f"<h{level}>{_inline_html(heading[2])}</h{level}>"
    if image := re.fullmatch(r"!\[(.*)\]\((.*)\)", block):
        source = images.get(image[2], image[2])
        return f'<img src="{html.escape(source)}" alt="{html.escape(image[1])}">'
    if block.startswith("| "):
        head, _, *lines = [line[2:-2].split(" | ") for line in block.splitlines()]
        rows = [_row_html("th", head), *(_row_html("td", line) for line in lines)]
        return f'<div class="wide"><table>{"".join(rows)}</table></div>'
    return f"<p>{_inline_html(block)}</p>"


def _row_html(tag: str, cells: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{_inline_html(cell)}</{tag}>' for cell in cells)}</tr>"


def _inline_html(text: str) -> str:
    escaped = re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(text))
    return re.sub(r"\*\*([^*]*)\*\*", r"<strong>\1</strong>", escaped)
