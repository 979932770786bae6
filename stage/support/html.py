"""Small pieces of HTML for notebooks: `_repr_html_` of stages, axes, reports, register maps and recordings."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import Any

from stage.support.extras import ExtraMissing

CELL = 'style="text-align:left"'


def table(rows: Iterable[Sequence[Any]], head: Sequence[Any] = ()) -> str:
    """Return a table with `head` above its rows. Texts are escaped."""
    above = f"<thead><tr>{''.join(f'<th {CELL}>{escape(str(h))}</th>' for h in head)}</tr></thead>" if head else ""
    body = "".join(f"<tr>{''.join(f'<td {CELL}>{escape(str(v))}</td>' for v in row)}</tr>" for row in rows)
    return f"<table>{above}<tbody>{body}</tbody></table>"


def heading(text: str) -> str:
    """Return a heading."""
    return f"<div><b>{escape(text)}</b></div>"


def folded(title: str, content: str) -> str:
    """Return content that opens by a click on its title."""
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def lines(text: str) -> str:
    """Return preformatted text."""
    return f"<pre>{escape(text)}</pre>"


def picture(draw: Callable[[], Any]) -> str:
    """Return the figure that `draw()` makes, in the page itself; a line that says what it needs where matplotlib is missing."""
    try:
        figure = draw()
    except ExtraMissing as missing:
        return f"<div><i>{escape(str(missing))}</i></div>"
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    data = base64.b64encode(out.getvalue()).decode()
    return f'<img style="max-width:100%" alt="{escape(str(figure.get_label() or "picture"))}" src="data:image/png;base64,{data}">'
