"""A server that answers as chat completions do, with replies that a test has written. No model is in it."""

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


def calls(*pairs, tokens=10):
    """A reply that calls tools: (name, arguments) each; arguments as text are sent as they are."""
    created = [
        {
            "id": f"c{k}",
            "type": "function",
            "function": {"name": n, "arguments": a if isinstance(a, str) else json.dumps(a)},
        }
        for k, (n, a) in enumerate(pairs)
    ]
    return {
        "choices": [{"message": {"role": "assistant", "content": None, "tool_calls": created}}],
        "usage": {"total_tokens": tokens},
    }


def says(text):
    """Return a reply that calls no tool."""
    return {"choices": [{"message": {"role": "assistant", "content": text}}], "usage": {"total_tokens": 1}}


class FakeModel:
    """An OpenAI-compatible server for tests, as a context manager. Each reply is a dict, a status, bytes or a function of the body.

    Attributes: url; requests: the bodies of the requests; heads: their headers."""

    def __init__(self, *replies):
        self.requests, self.heads, left = [], [], list(replies)
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self):
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                outer.requests.append(body)
                outer.heads.append(dict(self.headers))
                reply = left.pop(0) if left else says("nothing more")
                reply = reply(body) if callable(reply) else reply
                status, content = (reply, b"no") if isinstance(reply, int) else (200, reply)
                content = content if isinstance(content, bytes) else json.dumps(content).encode()
                self.send_response(status)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, *args):
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}/v1"

    def __enter__(self):
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *exc):
        self._server.shutdown()
        self._server.server_close()
