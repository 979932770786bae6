"""Who of those that look at a panel has the controls: one at a time. No page."""

from __future__ import annotations

from threading import Lock


class Controls:
    """The first who comes has them; whoever takes them has them; when he is gone, they are free and go to the next in line."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._here: list[str] = []
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

    def go(self, who: str) -> None:
        """He is gone."""
        with self._lock:
            if who in self._here:
                self._here.remove(who)
            if self.holder == who:
                self.holder = self._here[0] if self._here else None

    def take(self, who: str) -> None:
        """He has the controls now. Who has not come cannot take them."""
        with self._lock:
            if who in self._here:
                self.holder = who
