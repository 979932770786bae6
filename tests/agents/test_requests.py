"""The requests of the protocol, asked of its handlers: what each answers, and to whom."""

import asyncio
import base64
import json
from types import SimpleNamespace

import pytest

pytest.importorskip("mcp")

from stage import Stage, __version__
from stage.agents.server import mcp_handlers
from stage.agents.server.client_sessions import ClientSessions, ToolboxFactory
from stage.agents.server.mcp_handlers import NO_SESSION, ProtocolServer
from stage.agents.server.prompts import PROMPTS
from stage.agents.server.resources import list_pages
from stage.agents.tool import Answer


@pytest.fixture(scope="module")
def maker():
    return ToolboxFactory(lambda: Stage("xy", visuals=False), "truth")


@pytest.fixture
def served(maker):
    """Return `served(handler, key=..., **params)`, which calls a protocol handler for the session `key`."""
    sessions = ClientSessions(maker)
    created = ProtocolServer(maker, sessions, lambda ctx: ctx.key, sessionless=True, threads=2)

    def send_request(handler, /, key="a", **params):
        async def work():
            created._limiter, created._call_locks = None, {} if not keep else created._call_locks
            return await getattr(created, handler)(SimpleNamespace(key=key), SimpleNamespace(**params))

        keep = params.pop("keep", False)
        return asyncio.run(work())

    send_request.protocol, send_request.sessions = created, sessions
    yield send_request
    sessions.close_all()


def test_a_tool_is_listed_with_its_schema_and_whether_it_only_reads(served, maker):
    listed = served("_list_tools").tools
    assert [t.name for t in listed] == list(maker.catalog.tools)
    for tool, one in zip(maker.catalog.tools.values(), listed, strict=True):
        assert (one.description, one.input_schema) == (tool.text, tool.schema())
        assert one.annotations.read_only_hint == (tool.free or tool.name in ("status", "read_register"))
        assert one.annotations.open_world_hint is False


def test_an_answer_is_text_and_structure_and_a_picture_an_image_after_it():
    good = mcp_handlers._make_result(Answer(True, {"a": 1.5}))
    assert (good.is_error, good.structured_content) == (False, {"a": 1.5})
    assert [json.loads(c.text) for c in good.content] == [{"a": 1.5}]
    bad = mcp_handlers._make_result(Answer(False, {"error": "no."}))
    assert (bad.is_error, [c.text for c in bad.content]) == (True, ["no."])
    drawn = mcp_handlers._make_result(Answer(True, {"text": "a move"}, b"png"))
    assert [c.type for c in drawn.content] == ["text", "image"]
    assert (base64.b64decode(drawn.content[1].data), drawn.content[1].mime_type) == (b"png", "image/png")


def test_a_call_without_a_session_learns_how_to_open_one(served):
    message = served("_call_tool", key=None, name="budget", arguments={})
    assert message.is_error
    assert message.content[0].text == NO_SESSION
    assert len(served.sessions) == 0


def test_a_call_runs_in_the_session_of_its_client(served):
    served("_call_tool", key="a", name="move", arguments={"axis": "x", "pulses": 30, "accel": 0.01})
    for key, moves in (("a", 1), ("b", 0)):
        message = served("_call_tool", key=key, name="budget", arguments=None)
        assert message.structured_content["used"]["moves"] == moves
    served.sessions.close("a")
    delayed = served("_call_tool", key="a", name="budget", arguments=None)
    assert delayed.is_error
    assert "This session has ended" in delayed.content[0].text


def test_of_sessions_that_call_no_more_nothing_stays(served):
    served.sessions.limit = 2
    for k in range(9):
        served("_call_tool", key=f"k{k}", name="nothing", arguments={}, keep=True)
        served.sessions.close(f"k{k}")
        assert len(served.protocol._call_locks) <= 4
        assert f"k{k}" in served.protocol._call_locks


def test_every_page_is_listed_and_read_as_its_kind(served, maker):
    present = list_pages(maker.catalog)
    listed = served("_list_resources").resources
    reported = [(str(r.uri), r.name, r.description, r.mime_type) for r in listed]
    assert reported == [(p.uri, p.name, p.text, p.kind) for p in present.values()]
    served("_call_tool", name="move", arguments={"axis": "y", "pulses": 30, "accel": 0.01})
    for p in present.values():
        (text,) = served("_read_resource", uri=p.uri).contents
        assert (str(text.uri), text.mime_type) == (p.uri, p.kind)
        assert text.text == p.read(served.sessions.get_toolbox("a"))
    assert "preset move" in served("_read_resource", uri="stage://recording/last").contents[0].text
    assert served("_list_templates").resource_templates == []


NOT_READ = (("stage://axs", "a", "unknown resource"), ("stage://axes", None, "belongs to no session"))


@pytest.mark.parametrize(("uri", "key", "message"), NOT_READ)
def test_a_page_that_cannot_be_read_is_an_error_of_the_protocol_in_our_words(served, uri, key, message):
    with pytest.raises(mcp_handlers.MCPError, match=message) as error:
        served("_read_resource", key=key, uri=uri)
    assert error.value.error.code == mcp_handlers.types.INVALID_PARAMS


def test_every_prompt_is_listed_with_its_arguments_and_their_defaults(served):
    listed = served("_list_prompts").prompts
    assert [(p.name, p.description) for p in listed] == [(name, p.text) for name, p in PROMPTS.items()]
    arguments = {p.name: {a.name: (a.description, a.required) for a in p.arguments} for p in listed}
    assert arguments["tune_move"] == {"axis": ("which one", False), "distance": ("of the move (default 20mm)", False)}
    message = served("_get_prompt", name="tune_move", arguments={"axis": "y"}).messages
    assert [m.role for m in message] == ["user"]
    assert message[0].content.text.startswith("Tune one move of axis y: 20mm, as fast as it goes")
    with pytest.raises(mcp_handlers.MCPError, match="Did you mean 'tune_move'"):
        served("_get_prompt", name="tune_moves", arguments={})


def test_without_a_stage_no_prompts_and_no_resources_are_listed(served):
    served.protocol._factory = SimpleNamespace(catalog=SimpleNamespace(axes=(), stage=None))
    assert served("_list_prompts").prompts == []
    assert served("_list_resources").resources == []


def test_a_server_without_sessions_in_its_protocol_names_those_that_have_them(maker):
    old = ProtocolServer(maker, ClientSessions(maker), lambda ctx: None, sessionless=False, threads=1)
    message = asyncio.run(old._discover(None, None))
    assert message.supported_versions == list(mcp_handlers.HANDSHAKE_PROTOCOL_VERSIONS)
    assert message.instructions == mcp_handlers.INSTRUCTIONS
    assert message.capabilities.tools is not None
    assert (old.server.name, old.server.version, old.server.title) == ("pulsestage", __version__, "PulseStage")


CALLS = [
    ("tools/call", 1, {"name": "budget", "arguments": {}}, None), ("tools/call", 1, {"name": "budget"}, None),
    ("tools/call", 1, {"name": 5}, "not by 5"), ("tools/call", 1, None, "not by null"),
    ("tools/call", 1, {"name": "budget", "arguments": [1]}, "arguments of 'budget' should be an object, and not [1]"),
    ("tools/call", None, {"name": 5}, None), ("tools/list", 1, {"name": 5}, None),
]  # fmt: skip


@pytest.mark.parametrize(("method", "number", "params", "message"), CALLS)
def test_a_call_of_another_form_is_answered_as_one_of_wrong_arguments(method, number, params, message):
    async def after(ctx):
        return "passed on"

    created = asyncio.run(
        mcp_handlers._answer_malformed_call(SimpleNamespace(method=method, request_id=number, params=params), after)
    )
    if message is None:
        assert created == "passed on"
    else:
        assert created["isError"] is True
        assert message in created["content"][0]["text"]
        assert message in created["structuredContent"]["error"]
