"""Handlers of the Model Context Protocol for both transports: they answer the requests of client sessions."""

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
from stage.agents.server.client_sessions import ClientSessions, ToolboxFactory
from stage.agents.server.prompts import PROMPTS, fill_prompt
from stage.agents.server.resources import list_pages
from stage.agents.tool import Answer, Tool, make_failed_answer
from stage.agents.tool_arguments import format_value
from stage.agents.toolbox import Toolbox
from stage.errors import StageError, unknown_name_error

INSTRUCTIONS = """An emulated motion stage: chips on a bus make pulses, drives and motors move carriages. Begin with `describe`.
Time is simulated: it passes only in bus cycles, moves and waits. Your stage is yours; other sessions have others. An error says
what is allowed: read it."""
NO_SESSION = (
    "This request belongs to no session, and a stage lasts as long as a session: connect with the `initialize` handshake "
    f"({', '.join(HANDSHAKE_PROTOCOL_VERSIONS)}) and send the Mcp-Session-Id that comes back."
)
SessionKeyFinder = Callable[[ServerRequestContext[Any, Any]], str | None]


class ProtocolServer:
    """MCP server for the clients of one transport.

    Args:
        factory: Factory of the toolboxes; its catalog lists the tools.
        sessions: The open sessions.
        find_key: Function that returns the session key of a request, or None.
        sessionless: Whether the transport also accepts the newest protocol version, which has no sessions.
        threads: Greatest number of calls that run at once.
    """

    def __init__(
        self,
        factory: ToolboxFactory,
        sessions: ClientSessions,
        find_key: SessionKeyFinder,
        sessionless: bool,
        threads: int,
    ):
        self._factory, self._sessions, self._find_key, self._threads = factory, sessions, find_key, threads
        self._limiter: anyio.CapacityLimiter | None = None
        self._call_locks: dict[str, anyio.Lock] = {}
        self.server: Server[Any] = Server(
            "pulsestage", version=__version__, title="PulseStage", instructions=INSTRUCTIONS,
            on_list_tools=self._list_tools, on_call_tool=self._call_tool,
            on_list_resources=self._list_resources, on_read_resource=self._read_resource,
            on_list_resource_templates=self._list_templates,
            on_list_prompts=self._list_prompts, on_get_prompt=self._get_prompt,
        )  # fmt: skip
        self.server.middleware.append(_answer_malformed_call)
        if not sessionless:
            self.server.add_request_handler("server/discover", types.RequestParams, self._discover)

    async def _discover(self, ctx: Any, params: Any) -> types.DiscoverResult:
        """Offer only the protocol versions with sessions, because a stage must last from call to call."""
        return types.DiscoverResult(
            supported_versions=list(HANDSHAKE_PROTOCOL_VERSIONS),
            capabilities=self.server.get_capabilities(protocol_version=HANDSHAKE_PROTOCOL_VERSIONS[-1]),
            instructions=INSTRUCTIONS,
        )

    # --- tools ---

    async def _list_tools(self, ctx: Any, params: Any) -> types.ListToolsResult:
        catalog = await self._run_in_thread(lambda: self._factory.catalog)
        return types.ListToolsResult(tools=[_describe_tool(t) for t in catalog.tools.values()])

    async def _call_tool(self, ctx: Any, params: types.CallToolRequestParams) -> types.CallToolResult:
        key = self._find_key(ctx)
        if key is None:
            return _make_result(make_failed_answer(NO_SESSION))
        lock = self._call_locks.setdefault(key, anyio.Lock())
        if len(self._call_locks) > 2 * self._sessions.limit:
            self._call_locks = {k: lock for k, lock in self._call_locks.items() if lock.locked() or k == key}
        async with lock:  # a call that waits for its session takes no thread
            call = partial(self._call_toolbox, key, params.name, params.arguments)
            try:
                answer = await self._run_in_thread(call, abandon_on_cancel=True)
            except anyio.get_cancelled_exc_class():
                self._sessions.cancel_call(key)
                raise
        return _make_result(answer)

    def _call_toolbox(self, key: str, name: str, arguments: Any) -> Answer:
        """Call a tool in the toolbox of a session."""
        try:
            box = self._sessions.get_toolbox(key)
        except StageError as error:
            return make_failed_answer(str(error))
        return box.call(name, arguments)

    async def _run_in_thread(self, work: Callable[[], Any], abandon_on_cancel: bool = False) -> Any:
        """Run a function in one of the server's threads, and return its result."""
        if self._limiter is None:
            self._limiter = anyio.CapacityLimiter(self._threads)
        return await anyio.to_thread.run_sync(work, limiter=self._limiter, abandon_on_cancel=abandon_on_cancel)

    # --- resources and prompts ---

    async def _list_resources(self, ctx: Any, params: Any) -> types.ListResourcesResult:
        pages = await self._run_in_thread(lambda: list_pages(self._factory.catalog))
        listed = [types.Resource(uri=p.uri, name=p.name, description=p.text, mime_type=p.kind) for p in pages.values()]
        return types.ListResourcesResult(resources=listed)

    async def _list_templates(self, ctx: Any, params: Any) -> types.ListResourceTemplatesResult:
        """Return no templates: the list of resources is complete."""
        return types.ListResourceTemplatesResult(resource_templates=[])

    async def _read_resource(self, ctx: Any, params: types.ReadResourceRequestParams) -> types.ReadResourceResult:
        uri = str(params.uri)

        def read_page() -> tuple[str, str]:
            box, pages = self._find_toolbox(ctx), list_pages(self._factory.catalog)
            if uri not in pages:
                raise unknown_name_error("resource", uri, pages)
            return pages[uri].kind, pages[uri].read(box)

        kind, text = await self._run_with_protocol_errors(read_page)
        return types.ReadResourceResult(contents=[types.TextResourceContents(uri=uri, mime_type=kind, text=text)])

    async def _list_prompts(self, ctx: Any, params: Any) -> types.ListPromptsResult:
        catalog = await self._run_in_thread(lambda: self._factory.catalog)
        prompts = []
        for name, prompt in PROMPTS.items() if catalog.axes else ():
            arguments = [
                types.PromptArgument(name=n, description=text + (f" (default {d})" if d else ""), required=False)
                for n, (text, d) in prompt.arguments.items()
            ]
            prompts.append(types.Prompt(name=name, description=prompt.text, arguments=arguments))
        return types.ListPromptsResult(prompts=prompts)

    async def _get_prompt(self, ctx: Any, params: types.GetPromptRequestParams) -> types.GetPromptResult:
        text = await self._run_with_protocol_errors(
            lambda: fill_prompt(params.name, params.arguments, self._factory.catalog.axes)
        )
        message = types.PromptMessage(role="user", content=types.TextContent(type="text", text=text))
        return types.GetPromptResult(messages=[message])

    async def _run_with_protocol_errors(self, work: Callable[[], Any]) -> Any:
        """Run a function in a thread, and convert a StageError to an error of the protocol with the same text."""
        try:
            return await self._run_in_thread(work)
        except StageError as error:
            raise MCPError(types.INVALID_PARAMS, str(error)) from None

    def _find_toolbox(self, ctx: Any) -> Toolbox:
        key = self._find_key(ctx)
        if key is None:
            raise StageError(NO_SESSION)
        return self._sessions.get_toolbox(key)


async def _answer_malformed_call(ctx: Any, call_next: Any) -> Any:
    """Answer a malformed tool call with a tool error that says what is allowed, instead of an error of the protocol."""
    params = ctx.params or {}
    if ctx.method == "tools/call" and ctx.request_id is not None:
        name, arguments, error = params.get("name"), params.get("arguments"), ""
        if not isinstance(name, str):
            error = f'A tool is called by its name, such as {{"name": "describe", "arguments": {{}}}}, not by {format_value(name)}.'
        elif not isinstance(arguments, dict | None):
            error = f"The arguments of {format_value(name)} should be an object, and not {format_value(arguments)}."
        if error:
            return _make_result(make_failed_answer(error)).model_dump(by_alias=True, exclude_none=True, mode="json")
    return await call_next(ctx)


def _describe_tool(tool: Tool) -> types.Tool:
    read_only = tool.free or tool.name in ("status", "read_register")
    return types.Tool(
        name=tool.name,
        description=tool.text,
        input_schema=tool.schema(),
        annotations=types.ToolAnnotations(read_only_hint=read_only, open_world_hint=False),
    )


def _make_result(answer: Answer) -> types.CallToolResult:
    """Convert an answer to a result of the protocol."""
    content: list[Any] = [types.TextContent(type="text", text=answer.text)]
    if answer.png is not None:
        image = base64.b64encode(answer.png).decode()
        content.append(types.ImageContent(type="image", data=image, mime_type="image/png"))
    return types.CallToolResult(content=content, structured_content=answer.data, is_error=not answer.ok)
