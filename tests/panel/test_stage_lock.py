"""The lock of a stage that threads share: who is next, who waits, who is refused, and who is let go."""

import threading
import time

import pytest
from support.waiting import wait_until

from stage.errors import StageError
from stage.panel.stage_lock import FairStageLock


@pytest.fixture
def lock():
    return FairStageLock()


class LockingThread(threading.Thread):
    """Enters the lock, calls `inside()`, and leaves. `entered`: an Event; `error`: what it got in place of the lock."""

    def __init__(self, lock, inside=lambda: None):
        super().__init__(daemon=True)
        self.lock, self.inside = lock, inside
        self.entered, self.error = threading.Event(), None
        self.start()

    def run(self):
        try:
            with self.lock:
                self.entered.set()
                self.inside()
        except StageError as error:
            self.error = error


def test_one_thread_has_it_at_a_time_and_may_enter_again(lock):
    with lock, lock:
        assert lock.is_acquired()
        other = LockingThread(lock)
        wait_until(lambda: lock.has_waiting)
        with lock:
            pass
        assert not other.entered.wait(0.02)
    assert other.entered.wait(5)
    other.join(5)
    assert not lock.is_acquired()


def test_who_came_first_is_first_also_after_one_who_has_just_left(lock):
    order, visitors = [], []
    with lock:
        for k in range(4):
            visitors.append(LockingThread(lock, lambda k=k: order.append(k)))
            wait_until(lambda n=k: len(lock._waiting) == n + 1)
    with lock:  # at once again: those that wait were here before
        order.append("again")
    for visitor in visitors:
        visitor.join(5)
    assert order == [0, 1, 2, 3, "again"]


def test_waiting_releases_every_level_and_restores_the_same_depth(lock):
    with lock, lock:
        other = LockingThread(lock)
        lock.wait(0.05)
        assert other.entered.is_set()
        assert lock.is_acquired()
        lock.release()
        assert lock.is_acquired(), "once more than it was left"
        lock.acquire()
    assert not lock.is_acquired()


def test_yielding_admits_exactly_the_waiting_threads(lock):
    order = []
    with lock:
        first = LockingThread(lock, lambda: order.append("first"))
        wait_until(lambda: lock.has_waiting)
        lock.yield_to_waiting()
        order.append("owner")
        lock.yield_to_waiting()
    first.join(5)
    assert order == ["first", "owner"]


def test_a_wait_ends_on_notification_or_after_its_timeout(lock):
    begin = time.monotonic()
    with lock:
        lock.wait(0.03)
        assert time.monotonic() - begin > 0.02
        threading.Timer(0.02, lock.notify_all).start()
        lock.wait(30)
    assert time.monotonic() - begin < 15


def test_a_timed_out_thread_does_not_block_the_others(lock):
    with lock:
        impatient = threading.Thread(target=lambda: answers.append(lock.acquire(0.02)), daemon=True)
        answers: list[bool] = []
        impatient.start()
        impatient.join(5)
        assert answers == [False]
        assert not lock.has_waiting
    assert lock.acquire(0.02)
    lock.release()


def test_reserved_it_is_for_one_thread_and_the_others_wait_until_it_is_not(lock):
    lock.reserve(threading.get_ident())
    other = LockingThread(lock)
    wait_until(lambda: lock.has_waiting)
    for _ in range(3):
        with lock:  # past those that wait
            lock.yield_to_waiting()
    assert not other.entered.wait(0.02)
    lock.reserve(0)
    assert other.entered.wait(5)


@pytest.mark.parametrize("comes", ["before", "after"])
def test_a_reservation_with_a_refusal_refuses_all_other_threads_at_once(lock, comes):
    with lock:
        other = LockingThread(lock) if comes == "before" else None
        if other:
            wait_until(lambda: lock.has_waiting)
        lock.reserve(threading.get_ident(), "not yours.")
        other = other or LockingThread(lock)
        other.join(5)
    assert str(other.error) == "not yours."
    assert not lock.has_waiting


def test_who_is_refused_while_it_waits_inside_leaves_without_harm(lock):
    def inside():
        lock.wait()

    with lock:
        pass
    other = LockingThread(lock, inside)
    other.entered.wait(5)
    lock.reserve(threading.get_ident(), "not yours.")
    other.join(5)
    assert str(other.error) == "not yours."
    with lock:
        assert lock.is_acquired()


def test_a_thread_may_act_for_the_owner_that_waits_for_it(lock):
    """Firmware runs on a thread of its own, and calls Python there while its host waits."""
    done = threading.Event()

    def firmware():
        with lock.act_for_owner(), lock:
            done.set()

    with lock:
        thread = threading.Thread(target=firmware, daemon=True)
        thread.start()
        thread.join(5)
        assert done.is_set()
        assert lock.is_acquired()


def test_an_error_inside_leaves_the_lock_free(lock):
    with pytest.raises(ZeroDivisionError), lock, lock:
        raise ZeroDivisionError
    assert LockingThread(lock).entered.wait(5)


def test_only_its_thread_frees_a_lock_after_an_interrupt(lock):
    lock.acquire()
    lock.acquire()
    other = threading.Thread(target=lock.release_all, daemon=True)
    other.start()
    other.join(5)
    assert lock.is_acquired()
    lock.release_all()
    assert LockingThread(lock).entered.wait(5)


@pytest.mark.parametrize("moment", ["entered", "left"])
def test_release_all_frees_a_lock_that_ctrl_c_left_half_entered_or_half_left(lock, moment):
    """Ctrl-C between the two changes of state that entering, or leaving, consists of."""
    if moment == "entered":
        lock._acquire(False)
    else:
        lock.__enter__()
        lock._depth -= 1
    other = LockingThread(lock)
    assert not other.entered.wait(0.05)
    lock.release_all()
    assert other.entered.wait(5)
    other.join(5)
    with lock:
        assert lock.is_acquired()
