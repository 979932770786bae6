"""A player that is a language model behind an OpenAI-compatible endpoint. Nothing is called unless its URL is given."""

from __future__ import annotations

import http.client
import json
import time
import urllib.error
import urllib.request
from typing import Any

from registerbench.arena.game_session import GameSession
from stage.errors import ArgumentError, StageError
from stage.support.foreign_files import DocumentError, parse_json

REPLY_TIMEOUT_S = 300.0  # s for a reply
RETRIED_STATUS_CODES = (429, 500, 502, 503, 504)
MAX_ATTEMPTS = 4
MAX_SILENT_REPLIES = 3  # replies without a call, after which the game is left
MAX_REPLY_BYTES = 16 << 20  # bytes of a reply
PROMPT_RULES = "You act by calling tools, and by nothing else. Read each answer before the next call. The task:\n\n"


class EndpointPlayer:
    """Player that is a language model behind an OpenAI-compatible endpoint.

    Args:
        url: Address up to the version, such as https://host/v1.
        model: Name of the model at the endpoint.
        key: Bearer token; "" for none.
        pause: Seconds before the second attempt of a request; each further pause is twice as long.

    Raises:
        ArgumentError: The address is not one of HTTP, or the name of the model is empty.
    """

    def __init__(self, url: str, model: str, key: str = "", pause: float = 2.0):
        if not url.startswith(("http://", "https://")):
            raise ArgumentError(
                f"endpoint {url!r}: an address that begins with http:// or https://, as https://host/v1."
            )
        if not model:
            raise ArgumentError("the endpoint needs the name of a model: --model NAME.")
        self.url, self.model, self.name = url.rstrip("/") + "/chat/completions", model, model
        self._key, self._pause = key, pause

    def __call__(self, session: GameSession) -> None:
        """Play a game. Raises StageError if the endpoint does not answer as chat completions do."""
        messages: list[dict[str, Any]] = [{"role": "user", "content": PROMPT_RULES + session.task}]
        tools = [{"type": "function", "function": tool} for tool in session.tools]
        silent_replies = 0
        while not session.over and silent_replies < MAX_SILENT_REPLIES:
            message = self._request_message(session, messages, tools)
            messages.append(message)
            calls = message.get("tool_calls") or []
            silent_replies = 0 if calls else silent_replies + 1
            if not calls:
                session.count_trouble("a reply without a call")
                messages.append(
                    {"role": "user", "content": "Call a tool, or `finish` if there is one and you are done."}
                )
            for call in calls:
                messages.append(
                    {"role": "tool", "tool_call_id": str(call.get("id", "")), "content": _call_tool(session, call)}
                )

    def _request_message(
        self, session: GameSession, messages: list[dict[str, Any]], tools: list[dict[str, Any]]
    ) -> dict[str, Any]:
        """Send the conversation to the endpoint, and return the model's message; repeat a request that fails for a moment.

        Args:
            session: Session of the game.
            messages: Conversation so far.
            tools: Tools, as the endpoint takes them.
        """
        reply = self._post(session, {"model": self.model, "messages": messages, "tools": tools})
        try:
            message = reply["choices"][0]["message"]
            calls = message.get("tool_calls") or []
            if not isinstance(message, dict) or not all(isinstance(c, dict) for c in calls):
                raise TypeError("its message is none")
            usage = reply.get("usage")
        except (KeyError, IndexError, TypeError, ValueError, AttributeError) as why:
            raise StageError(
                f"{self.url} does not answer as chat completions do ({why!r}): {str(reply)[:200]}"
            ) from None
        if isinstance(usage, dict) and usage.get("total_tokens") is not None:
            session.count_tokens(usage["total_tokens"])
        stored = {"role": "assistant", "content": message.get("content") or ""}
        return {**stored, "tool_calls": calls} if calls else stored

    def _post(self, session: GameSession, body: dict[str, Any]) -> Any:
        """Post a request and return the reply, parsed from JSON."""
        head = {"Content-Type": "application/json", **({"Authorization": f"Bearer {self._key}"} if self._key else {})}
        request = urllib.request.Request(self.url, json.dumps(body).encode(), head)
        for attempt in range(MAX_ATTEMPTS):
            try:
                with _OPENER.open(request, timeout=REPLY_TIMEOUT_S) as reply:
                    return parse_json(_read_reply(session, reply))
            except urllib.error.HTTPError as error:
                if error.code not in RETRIED_STATUS_CODES or attempt == MAX_ATTEMPTS - 1:
                    text = error.read(300).decode(errors="replace")
                    raise StageError(f"{self.url}: {error.code} {error.reason}: {text}") from None
            except (urllib.error.URLError, TimeoutError, ConnectionError) as error:
                if attempt == MAX_ATTEMPTS - 1:
                    raise StageError(f"{self.url} cannot be reached: {getattr(error, 'reason', error)}.") from None
            except DocumentError as error:
                raise StageError(f"{self.url} does not answer in JSON: {error}.") from None
            except http.client.HTTPException as error:
                raise StageError(f"{self.url} does not answer as a server does: {error!r}.") from None
            time.sleep(self._pause * 2**attempt)
        raise AssertionError("unreachable")


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Handler that follows no redirection, because the key and the game would go to an address that the user did not name."""

    def redirect_request(self, *_: Any) -> None:
        return None


_OPENER = urllib.request.build_opener(_NoRedirect)


def _read_reply(session: GameSession, reply: Any) -> bytes:
    """Read a reply until it ends, is too long, or the game is over."""
    parts, size = [], 0
    while size < MAX_REPLY_BYTES and not session.over and (part := reply.read1(1 << 16)):
        parts.append(part)
        size += len(part)
    return b"".join(parts)


def _call_tool(session: GameSession, call: dict[str, Any]) -> str:
    """Make a tool call that the model requested, and return the answer as text for the model."""
    function = call.get("function") or {}
    text = function.get("arguments") or "{}"
    try:
        arguments = parse_json(text) if isinstance(text, str) else text
    except DocumentError:
        arguments = text  # the tool says what it should be
    answer = session.call(function.get("name"), arguments)
    return answer.text if answer.ok else f"error: {answer.text}"
