"""The process of a policy: it reads pickled observations, and answers with actions as lines of JSON.

python -m registerbench.policy_worker module:name      is what `ProcessPolicy` starts
"""

from __future__ import annotations

import base64
import json
import pickle
import sys
from typing import Any, TextIO

import numpy as np

from registerbench.policies import PolicyPlayer, import_policy, take_standard_output
from stage.errors import ArgumentError


def serve_policy(name: str, requests: TextIO, answers: TextIO) -> None:
    """Answer the requests of a `ProcessPolicy` until its pipe is closed.

    Args:
        name: Policy as "module:name".
        requests: Lines with pickled messages.
        answers: Where the answers go, as lines of JSON.
    """
    policy: PolicyPlayer | None = None
    for line in requests:
        message = pickle.loads(base64.b64decode(line))  # written by the benchmark
        answer: dict[str, Any] = {}
        try:
            if "path" in message:
                sys.path[:] = message["path"]
                policy = PolicyPlayer(import_policy(name), name)
            elif "context" in message:
                policy.begin(message["context"])  # type: ignore[union-attr]
            else:
                action = np.asarray(policy.act(message["observation"], message["info"]))  # type: ignore[union-attr]
                answer = {"action": action.tolist(), "type": action.dtype.name}
            answer["cost"] = policy.cost if policy else {}
        except ArgumentError as error:
            answer = {"refused": str(error)}
        except Exception as error:
            answer = {"failed": f"{type(error).__name__}: {error}"[:1000]}
        answers.write(json.dumps(answer, default=repr) + "\n")
        answers.flush()


if __name__ == "__main__":
    with take_standard_output() as pipe:
        serve_policy(sys.argv[1], sys.stdin, pipe)
