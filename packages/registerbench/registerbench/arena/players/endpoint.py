"""A player that is a language model behind an OpenAI-compatible endpoint. Nothing is called unless its URL is given."""

from __future__ import annotations

import http.client
import json
import time
import urllib.error
import urllib.request
from typing import Any

from registerbench.arena.table import Table
from stage.errors import ArgumentError, StageError
from stage.support.foreign_files import DocumentError, parse_json

TIMEOUT = 300.0  # s for a reply
AGAIN = (429, 500, 502, 503, 504)
MAX_ATTEMPTS = 4
SILENT = 3  # replies without a call, after which the game is left
LARGEST = 16 << 20  # bytes of a reply
RULES = "You act by calling tools, and by nothing else. Read each answer before the next call. The task:\n\n"


class Endpoint:
    """url: up to the version, as https://host/v1; model: its name there; key: a bearer token; pause: s before another try."""

    def __init__(self, url: str, model: str, key: str = "", pause: float = 2.0):
        if not url.startswith(("http://", "https://")):
            raise ArgumentError(
                f"endpoint {url!r}: an address that begins with http:// or https://, as https://host/v1."
            )
        if not model:
            raise ArgumentError("the endpoint needs the name of a model: --model NAME.")
        self.url, self.model, self.name = url.rstrip("/") + "/chat/completions", model, model
        self._key, self._pause = key, pause

    def __call__(self, table: Table) -> None:
        """Play. Raises StageError where the endpoint does not answer as one."""
        messages: list[dict[str, Any]] = [{"role": "user", "content": RULES + table.task}]
        tools = [{"type": "function", "function": tool} for tool in table.tools]
        silent = 0
        while not table.over and silent < SILENT:
            message = self._reply(table, messages, tools)
            messages.append(message)
            calls = message.get("tool_calls") or []
            silent = 0 if calls else silent + 1
            if not calls:
                table.trouble("a reply without a call")
                messages.append(
                    {"role": "user", "content": "Call a tool, or `finish` if there is one and you are done."}
                )
            for call in calls:
                messages.append(
                    {"role": "tool", "tool_call_id": str(call.get("id", "")), "content": _called(table, call)}
                )

    def _reply(self, table: Table, messages: list[dict[str, Any]], tools: list[dict[str, Any]]) -> dict[str, Any]:
        said = self._request(table, {"model": self.model, "messages": messages, "tools": tools})
        try:
            message = said["choices"][0]["message"]
            calls = message.get("tool_calls") or []
            if not isinstance(message, dict) or not all(isinstance(c, dict) for c in calls):
                raise TypeError("its message is none")
            usage = said.get("usage")
        except (KeyError, IndexError, TypeError, ValueError, AttributeError) as why:
            raise StageError(
                f"{self.url} does not answer as chat completions do ({why!r}): {str(said)[:200]}"
            ) from None
        if isinstance(usage, dict) and usage.get("total_tokens") is not None:
            table.spent(usage["total_tokens"])
        kept = {"role": "assistant", "content": message.get("content") or ""}
        return {**kept, "tool_calls": calls} if calls else kept

    def _request(self, table: Table, body: dict[str, Any]) -> Any:
        head = {"Content-Type": "application/json", **({"Authorization": f"Bearer {self._key}"} if self._key else {})}
        request = urllib.request.Request(self.url, json.dumps(body).encode(), head)
        for tried in range(MAX_ATTEMPTS):
            try:
                with _OPENER.open(request, timeout=TIMEOUT) as reply:
                    return parse_json(_all(table, reply))
            except urllib.error.HTTPError as error:
                if error.code not in AGAIN or tried == MAX_ATTEMPTS - 1:
                    text = error.read(300).decode(errors="replace")
                    raise StageError(f"{self.url}: {error.code} {error.reason}: {text}") from None
            except (urllib.error.URLError, TimeoutError, ConnectionError) as error:
                if tried == MAX_ATTEMPTS - 1:
                    raise StageError(f"{self.url} cannot be reached: {getattr(error, 'reason', error)}.") from None
            except DocumentError as error:
                raise StageError(f"{self.url} does not answer in JSON: {error}.") from None
            except http.client.HTTPException as error:
                raise StageError(f"{self.url} does not answer as a server does: {error!r}.") from None
            time.sleep(self._pause * 2**tried)
        raise AssertionError("unreachable")


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Another address is called by nobody who was not given it: the key and the game would go there."""

    def redirect_request(self, *_: Any) -> None:
        return None


_OPENER = urllib.request.build_opener(_NoRedirect)


def _all(table: Table, reply: Any) -> bytes:
    """What comes, while somebody waits for it."""
    parts, size = [], 0
    while size < LARGEST and not table.over and (part := reply.read1(1 << 16)):
        parts.append(part)
        size += len(part)
    return b"".join(parts)


def _called(table: Table, call: dict[str, Any]) -> str:
    """What came of a tool call of the model."""
    function = call.get("function") or {}
    text = function.get("arguments") or "{}"
    try:
        arguments = parse_json(text) if isinstance(text, str) else text
    except DocumentError:
        arguments = text  # the tool says what it should be
    answer = table.call(function.get("name"), arguments)
    return answer.text if answer.ok else f"error: {answer.text}"
