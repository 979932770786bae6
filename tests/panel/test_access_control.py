"""The panel's server answers its own pages only, and one of those that look has the controls."""

import asyncio
import logging
from types import SimpleNamespace

import pytest

from stage.panel.access_control import (
    COOKIE,
    LOGGERS,
    MALFORMED,
    SERVER_LOGGER,
    ControlsAssignment,
    FirstRecordFilter,
    RequestGuard,
    report_malformed_messages_once,
    report_task_error,
)

NAMES = frozenset({"127.0.0.1:7241", "localhost:7241"})


@pytest.fixture(autouse=True)
def loggers_without_filters():
    """Take the filters that a panel of another test has put on the loggers away, for a filter reports once in a process."""
    loggers = [logging.getLogger(name) for name in (*LOGGERS, SERVER_LOGGER)]
    before = [list(logger.filters) for logger in loggers]
    for logger in loggers:
        logger.filters.clear()
    yield
    for logger, filters in zip(loggers, before, strict=True):
        logger.filters[:] = filters


def requested(guard, kind="http", query=b"", **headers):
    """Return the messages of the guard, and whether it let the request through."""
    sent, through = [], []

    async def app(scope, receive, send):
        through.append(scope)
        await send({"type": "http.response.start", "status": 200, "headers": []})

    guard._app = app

    async def send(message):
        sent.append(message)

    arguments = [(name.encode(), value.encode()) for name, value in headers.items()]
    asyncio.run(guard({"type": kind, "headers": arguments, "query_string": query}, None, send))
    return bool(through), sent


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_a_foreign_name_of_the_host_is_refused(kind):
    assert requested(RequestGuard(None, NAMES), kind, host="127.0.0.1:7241")[0]
    through, sent = requested(RequestGuard(None, NAMES), kind, host="evil.example:7241")
    assert not through
    assert sent[0].get("status", 403) == 403
    assert sent[0]["type"] in ("http.response.start", "websocket.close")


def test_a_page_from_elsewhere_is_refused():
    assert requested(RequestGuard(None, NAMES), host="localhost:7241", origin="http://localhost:7241")[0]
    assert requested(RequestGuard(None, NAMES), host="LOCALHOST:7241", origin="http://LocalHost:7241")[0], (
        "names are of any case"
    )
    assert not requested(RequestGuard(None, NAMES), host="localhost:7241", origin="http://evil.example")[0]
    assert not requested(RequestGuard(None, NAMES), host="localhost:7241", origin="null")[0]


def test_strangers_need_the_token_and_a_browser_keeps_it():
    guard = RequestGuard(None, frozenset(), "secret")
    assert not requested(guard, host="stage.example")[0]
    assert not requested(guard, host="stage.example", query=b"token=wrong")[0]
    through, sent = requested(guard, host="stage.example", query=b"token=secret")
    assert through
    cookie = dict(sent[0]["headers"])[b"set-cookie"].decode()
    assert cookie.startswith(f"{COOKIE}=secret;")
    assert "HttpOnly" in cookie
    assert requested(guard, "websocket", host="stage.example", cookie=f"{COOKIE}=secret")[0]
    assert not requested(guard, "websocket", host="stage.example", cookie=f"{COOKIE}=other")[0]


@pytest.mark.parametrize("cookie", ["a/b=c", "a,b=c", '=; ="'])
def test_cookies_that_are_none_are_refused_in_words(cookie):
    through, sent = requested(RequestGuard(None, NAMES, "secret"), host="127.0.0.1:7241", cookie=cookie)
    assert not through
    assert sent[0]["status"] == 403


def test_the_content_policy_allows_this_server_only():
    _, sent = requested(RequestGuard(None, NAMES), host="127.0.0.1:7241")
    policy = dict(sent[0]["headers"])[b"content-security-policy"].decode()
    assert "default-src 'self'" in policy
    assert "http:" not in policy
    assert "*" not in policy


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize("header", [{"origin": "http://["}, {"origin": "http://[::1"}, {"cookie": "a b=c; \x01=;=,"}])
def test_headers_that_make_no_sense_are_refused_and_no_error_of_the_server(kind, header):
    """Origin: http://[ gave 500 and a traceback"""
    through, sent = requested(RequestGuard(None, frozenset(), "secret"), kind, host="127.0.0.1:7241", **header)
    assert not through
    assert (sent[0].get("status"), sent[0].get("code")) in ((403, None), (None, 1008))


def test_a_socket_whose_messages_make_no_sense_is_closed_and_the_terminal_gets_one_line(caplog):
    """29,000 lines were written for some hundred messages"""

    async def app(scope, receive, send):
        raise ValueError("no packet")

    first, sent = FirstRecordFilter(), []
    for name in LOGGERS:
        logging.getLogger(name).addFilter(first)
    try:
        for _ in range(3):
            scope = {"type": "websocket", "headers": [(b"host", b"localhost:7241")]}

            async def send(message):
                sent.append(message["code"])

            asyncio.run(RequestGuard(app, NAMES)(scope, None, send))
            logging.getLogger("engineio.server").error("message async handler error")
    finally:
        for name in LOGGERS:
            logging.getLogger(name).removeFilter(first)
    assert sent == [1007, 1007, 1007]
    (record,) = caplog.records
    assert "malformed message came to the panel, and was ignored (ValueError('no packet'))" in record.getMessage()
    assert record.exc_info is None


def test_text_that_is_not_utf_8_is_one_line_and_other_errors_of_the_server_are_reported(caplog):
    reported = []
    report_malformed_messages_once()
    for _ in range(3):
        try:
            b"\xff".decode()
        except UnicodeDecodeError as error:  # as uvicorn takes it, and then fails as it closes the connection
            logging.getLogger(SERVER_LOGGER).exception("Invalid UTF-8 sequence received from client.")
            loop = SimpleNamespace(default_exception_handler=reported.append)
            report_task_error(
                loop, {"message": "Fatal error: protocol.data_received() call failed.", "exception": error}
            )
    logging.getLogger(SERVER_LOGGER).error("no port")
    report_task_error(loop, {"message": "Task exception was never retrieved"})
    assert [(r.name, r.exc_info) for r in caplog.records] == [(MALFORMED.name, None), (SERVER_LOGGER, None)]
    assert "malformed message came to the panel, and was ignored (UnicodeDecodeError(" in caplog.text
    assert reported == [{"message": "Task exception was never retrieved"}]


def test_the_first_browser_has_the_controls_until_another_takes_them():
    controls = ControlsAssignment()
    assert controls.holder is None
    controls.add_browser("a")
    controls.add_browser("b")
    controls.add_browser("b")
    assert (controls.holder, controls.browser_count) == ("a", 2)
    controls.give_controls_to("b")
    assert controls.holder == "b"
    controls.give_controls_to("stranger")
    assert controls.holder == "b"


def test_a_leaving_browser_passes_the_controls_to_the_next():
    controls = ControlsAssignment()
    for who in "abc":
        controls.add_browser(who)
    controls.disconnect_browser("b")
    assert controls.holder == "a"
    controls.disconnect_browser("a")
    assert (controls.holder, controls.browser_count) == ("c", 1)
    controls.disconnect_browser("c")
    assert controls.holder is None
    controls.add_browser("d")
    assert controls.holder == "d"


def test_who_loses_the_controls_lets_go_of_what_he_holds():
    controls, released = ControlsAssignment(), []
    for who in "ab":
        controls.add_browser(who)
        controls.call_when_controls_lost(who, lambda who=who: released.append(who))
    controls.give_controls_to("a")
    assert released == []
    controls.give_controls_to("b")
    controls.give_controls_to("b")
    assert released == ["a"]
    controls.disconnect_browser("a")
    assert released == ["a"]
    controls.disconnect_browser("b")
    assert released == ["a", "b"]
