"""The requests of the protocol, answered from sessions; the same for both transports."""

from __future__ import annotations

import base64
from collections.abc import Callable
from functools import partial
from typing import Any

import anyio
import anyio.to_thread
import mcp_types as types
from mcp.server import Server, ServerRequestContext
from mcp.shared.exceptions import MCPError
from mcp_types.version import HANDSHAKE_PROTOCOL_VERSIONS

from stage import __version__
from stage.agents.fields import shown
from stage.agents.server import prompts, resources
from stage.agents.server.sessions import Maker, Sessions
from stage.agents.tool import Answer, Tool
from stage.agents.toolbox import Toolbox
from stage.errors import StageError

INSTRUCTIONS = """An emulated motion stage: chips on a bus make pulses, drives and motors move carriages. Begin with `describe`.
Time is simulated: it passes in bus cycles, moves and waits alone. Your stage is yours; other sessions have others. A refusal says
what is allowed: read it."""
Key = Callable[[ServerRequestContext[Any, Any]], str | None]


class Protocol:
    """A server for the clients of one transport. key: of the session that a request belongs to; None where it has none."""

    def __init__(self, maker: Maker, sessions: Sessions, key: Key, modern: bool, threads: int):
        self._maker, self._sessions, self._key, self._threads = maker, sessions, key, threads
        self._limiter: anyio.CapacityLimiter | None = None
        self._turns: dict[str, anyio.Lock] = {}
        self.server: Server[Any] = Server(
            "pulsestage", version=__version__, title="PulseStage", instructions=INSTRUCTIONS,
            on_list_tools=self._list_tools, on_call_tool=self._call_tool,
            on_list_resources=self._list_resources, on_read_resource=self._read_resource,
            on_list_resource_templates=self._list_templates,
            on_list_prompts=self._list_prompts, on_get_prompt=self._get_prompt,
        )  # fmt: skip
        self.server.middleware.append(_teach)
        if not modern:
            self.server.add_request_handler("server/discover", types.RequestParams, self._discover)

    async def _discover(self, ctx: Any, params: Any) -> types.DiscoverResult:
        """A stage lasts from call to call, so clients have to open a session, which the newest protocol has none of."""
        return types.DiscoverResult(
            supported_versions=list(HANDSHAKE_PROTOCOL_VERSIONS),
            capabilities=self.server.get_capabilities(protocol_version=HANDSHAKE_PROTOCOL_VERSIONS[-1]),
            instructions=INSTRUCTIONS,
        )

    # --- tools ---

    async def _list_tools(self, ctx: Any, params: Any) -> types.ListToolsResult:
        catalogue = await self._in_thread(lambda: self._maker.catalogue)
        return types.ListToolsResult(tools=[_tool(t) for t in catalogue.tools.values()])

    async def _call_tool(self, ctx: Any, params: types.CallToolRequestParams) -> types.CallToolResult:
        key = self._key(ctx)
        if key is None:
            return _result(Answer(False, {"error": NO_SESSION}))
        turn = self._turns.setdefault(key, anyio.Lock())
        if len(self._turns) > 2 * self._sessions.most:
            self._turns = {k: lock for k, lock in self._turns.items() if lock.locked() or k == key}
        async with turn:  # a thread for each that works, none for those that wait
            try:
                answer = await self._in_thread(partial(self._call, key, params.name, params.arguments), leave=True)
            except anyio.get_cancelled_exc_class():
                self._sessions.cancel(key)
                raise
        return _result(answer)

    def _call(self, key: str, name: str, arguments: Any) -> Answer:
        try:
            box = self._sessions.box(key)
        except StageError as error:
            return Answer(False, {"error": str(error)})
        return box.call(name, arguments)

    async def _in_thread(self, work: Callable[[], Any], leave: bool = False) -> Any:
        """leave: whoever has asked may go before it is done."""
        if self._limiter is None:
            self._limiter = anyio.CapacityLimiter(self._threads)
        return await anyio.to_thread.run_sync(work, limiter=self._limiter, abandon_on_cancel=leave)

    # --- resources and prompts ---

    async def _list_resources(self, ctx: Any, params: Any) -> types.ListResourcesResult:
        pages = await self._in_thread(lambda: resources.pages(self._maker.catalogue))
        listed = [types.Resource(uri=p.uri, name=p.name, description=p.text, mime_type=p.kind) for p in pages.values()]
        return types.ListResourcesResult(resources=listed)

    async def _list_templates(self, ctx: Any, params: Any) -> types.ListResourceTemplatesResult:
        """None: every resource is listed."""
        return types.ListResourceTemplatesResult(resource_templates=[])

    async def _read_resource(self, ctx: Any, params: types.ReadResourceRequestParams) -> types.ReadResourceResult:
        def look() -> tuple[str, str]:
            box = self._box(ctx)
            page = resources.read(resources.pages(self._maker.catalogue), str(params.uri), box)
            return page.kind, page.read(box)

        kind, text = await self._told(look)
        content = types.TextResourceContents(uri=str(params.uri), mime_type=kind, text=text)
        return types.ReadResourceResult(contents=[content])

    async def _list_prompts(self, ctx: Any, params: Any) -> types.ListPromptsResult:
        def listed(name: str, asked: prompts.Asked) -> types.Prompt:
            arguments = [
                types.PromptArgument(name=n, description=text + (f" (default {d})" if d else ""), required=False)
                for n, (text, d) in asked.arguments.items()
            ]
            return types.Prompt(name=name, description=asked.text, arguments=arguments)

        catalogue = await self._in_thread(lambda: self._maker.catalogue)
        rows = prompts.PROMPTS.items() if catalogue.axes else ()
        return types.ListPromptsResult(prompts=[listed(*row) for row in rows])

    async def _get_prompt(self, ctx: Any, params: types.GetPromptRequestParams) -> types.GetPromptResult:
        text = await self._told(lambda: prompts.prompt(params.name, params.arguments, self._maker.catalogue.axes))
        message = types.PromptMessage(role="user", content=types.TextContent(type="text", text=text))
        return types.GetPromptResult(messages=[message])

    async def _told(self, work: Callable[[], Any]) -> Any:
        """`work()`; what is wrong becomes an error of the protocol, in our words."""
        try:
            return await self._in_thread(work)
        except StageError as error:
            raise MCPError(types.INVALID_PARAMS, str(error)) from None

    def _box(self, ctx: Any) -> Toolbox:
        key = self._key(ctx)
        if key is None:
            raise StageError(NO_SESSION)
        return self._sessions.box(key)


async def _teach(ctx: Any, call_next: Any) -> Any:
    """A call whose very form is wrong is answered as one whose arguments are: by a tool error that says what is allowed."""
    given = ctx.params or {}
    if ctx.method == "tools/call" and ctx.request_id is not None:
        name, arguments = given.get("name"), given.get("arguments")
        if not isinstance(name, str):
            return _wrong(
                f'a tool is called by its name, {{"name": "describe", "arguments": {{}}}}, and {shown(name)} was given.'
            )
        if not isinstance(arguments, dict | None):
            return _wrong(f"the arguments of {shown(name)} are {shown(arguments)}, and should be an object.")
    return await call_next(ctx)


def _wrong(said: str) -> dict[str, Any]:
    return _result(Answer(False, {"error": said})).model_dump(by_alias=True, exclude_none=True, mode="json")


NO_SESSION = (
    "this request belongs to no session, and a stage lasts for one: connect with the `initialize` handshake "
    f"({', '.join(HANDSHAKE_PROTOCOL_VERSIONS)}) and send the Mcp-Session-Id that comes back."
)


def _tool(tool: Tool) -> types.Tool:
    looks = tool.free or tool.name in ("status", "read_register")
    return types.Tool(
        name=tool.name,
        description=tool.text,
        input_schema=tool.schema(),
        annotations=types.ToolAnnotations(read_only_hint=looks, open_world_hint=False),
    )


def _result(answer: Answer) -> types.CallToolResult:
    content: list[Any] = [types.TextContent(type="text", text=answer.text)]
    if answer.png is not None:
        image = base64.b64encode(answer.png).decode()
        content.append(types.ImageContent(type="image", data=image, mime_type="image/png"))
    return types.CallToolResult(content=content, structured_content=answer.data, is_error=not answer.ok)
