"""RegisterBench: fixed test episodes of the environments, entries that are files of actions, and their replay bit for bit.

    from stage import bench

    entry = bench.play("random", "few-shot", "train")     a player's name, or a policy: see players.py
    bench.submit(entry, "random.bench")
    print(bench.verify("random.bench"))                   plays the actions again, without the policy

cards.py has the tasks and their test episodes; files.py the format; playing.py plays, replaying.py compares; players.py what a
policy is; shipped.py those that come with the bench; statistics.py when one method beats another. docs/benchmark.md is the page.
"""

from stage.bench.cards import CARDS, Card, seeds
from stage.bench.files import Submission, read
from stage.bench.playing import play, submit
from stage.bench.replaying import Verdict, verify

__all__ = ["CARDS", "Card", "Submission", "Verdict", "play", "read", "seeds", "submit", "verify"]
