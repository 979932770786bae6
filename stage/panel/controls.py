"""Who of those that look at a panel has the controls: one at a time. No page."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock


class Controls:
    """The first who comes has them; whoever takes them has them; when he is gone, they are free and go to the next in line."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._here: list[str] = []
        self._letting_go: dict[str, list[Callable[[], None]]] = {}
        self.holder: str | None = None

    @property
    def watching(self) -> int:
        """How many look."""
        return len(self._here)

    def come(self, who: str) -> None:
        """Somebody looks from now on."""
        with self._lock:
            if who not in self._here:
                self._here.append(who)
            self.holder = self.holder or who

    def when_lost(self, who: str, let_go: Callable[[], None]) -> None:
        """Have `let_go` called when he has the controls no more: what he holds he could not release then."""
        self._letting_go.setdefault(who, []).append(let_go)

    def go(self, who: str) -> None:
        """He is gone."""
        with self._lock:
            if who in self._here:
                self._here.remove(who)
            lost = self.holder == who
            if lost:
                self.holder = self._here[0] if self._here else None
        self._let_go(lost, who)

    def forget(self, who: str) -> None:
        """He will not come back."""
        self.go(who)
        self._letting_go.pop(who, None)

    def take(self, who: str) -> None:
        """He has the controls now. Who has not come cannot take them."""
        with self._lock:
            before = self.holder
            if who in self._here:
                self.holder = who
        self._let_go(before not in (None, self.holder), before or "")

    def _let_go(self, lost: bool, who: str) -> None:
        for let_go in self._letting_go.get(who, ()) if lost else ():
            let_go()
