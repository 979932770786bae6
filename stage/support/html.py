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
    """A table, a row each; `head` above it. Texts are escaped."""
    above = f"<thead><tr>{''.join(f'<th {CELL}>{escape(str(h))}</th>' for h in head)}</tr></thead>" if head else ""
    body = "".join(f"<tr>{''.join(f'<td {CELL}>{escape(str(v))}</td>' for v in row)}</tr>" for row in rows)
    return f"<table>{above}<tbody>{body}</tbody></table>"


def heading(text: str) -> str:
    """What stands above."""
    return f"<div><b>{escape(text)}</b></div>"


def folded(title: str, content: str) -> str:
    """What opens by a click."""
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def lines(text: str) -> str:
    """Text as it is."""
    return f"<pre>{escape(text)}</pre>"


def picture(draw: Callable[[], Any]) -> str:
    """The figure that `draw()` makes, in the page itself; a line that says what it needs where matplotlib is missing."""
    try:
        figure = draw()
    except ExtraMissing as missing:
        return f"<div><i>{escape(str(missing))}</i></div>"
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    data = base64.b64encode(out.getvalue()).decode()
    return f'<img style="max-width:100%" alt="{escape(str(figure.get_label() or "picture"))}" src="data:image/png;base64,{data}">'
