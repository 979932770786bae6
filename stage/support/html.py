"""Small pieces of HTML for notebooks: `_repr_html_` of stages, axes, reports, register maps and recordings."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import Any

from stage.support.extras import ExtraMissing

CELL_STYLE = 'style="text-align:left"'


def format_table(rows: Iterable[Sequence[Any]], headings: Sequence[Any] = ()) -> str:
    """Format rows as a table with `headings` above its columns. Texts are escaped."""
    above = (
        f"<thead><tr>{''.join(f'<th {CELL_STYLE}>{escape(str(h))}</th>' for h in headings)}</tr></thead>"
        if headings
        else ""
    )
    body = "".join(f"<tr>{''.join(f'<td {CELL_STYLE}>{escape(str(v))}</td>' for v in row)}</tr>" for row in rows)
    return f"<table>{above}<tbody>{body}</tbody></table>"


def format_heading(text: str) -> str:
    """Format a heading."""
    return f"<div><b>{escape(text)}</b></div>"


def format_collapsible(title: str, content: str) -> str:
    """Format content that a click on its title shows and hides; `content` is HTML."""
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def format_preformatted(text: str) -> str:
    """Format text as preformatted: line breaks and spaces stay."""
    return f"<pre>{escape(text)}</pre>"


def embed_figure(draw: Callable[[], Any]) -> str:
    """Draw a figure by `draw()` and return an image element that contains it; without matplotlib, a line that names the extra."""
    try:
        figure = draw()
    except ExtraMissing as missing:
        return f"<div><i>{escape(str(missing))}</i></div>"
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    data = base64.b64encode(out.getvalue()).decode()
    return f'<img style="max-width:100%" alt="{escape(str(figure.get_label() or "picture"))}" src="data:image/png;base64,{data}">'
