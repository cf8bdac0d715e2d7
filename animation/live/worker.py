"""A process that refines the answers of one tab: the newest change alone, given up for a newer one.

It ends with its tab, and with the server, whatever it is doing: once the pipe to the server is gone, so is it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection

from threadpoolctl import threadpool_limits

from ...lhm.base.errors import SoftdecaError
from ...reference import Face
from .messages import Change, DerivativesFound, Frame, Note
from .refinement import Refinement, SupersededError

QUIET = 0.15
"""[s] without another change before p is prepared, which takes seconds: a slider that moves asks for nothing yet."""

Message = Frame | DerivativesFound | Note
OnMessage = Callable[[Message], None]


class Newest:
    """The newest change of a tab, put by one thread and taken by another."""

    def __init__(self):
        self._has_changed = threading.Condition()
        self._change: Change | None = None
        self._is_taken = True

    def put(self, change: Change) -> None:
        """Replace the change."""
        with self._has_changed:
            self._change, self._is_taken = change, False
            self._has_changed.notify()

    def take(self) -> Change:
        """Wait for a change that was not taken yet."""
        with self._has_changed:
            self._has_changed.wait_for(lambda: not self._is_taken)
            self._is_taken = True
            assert self._change is not None
            return self._change

    def is_another(self, change: Change) -> bool:
        """Return whether there is another than this one."""
        return self._change is not change

    def is_another_face(self, change: Change) -> bool:
        """Return whether there is one with another p."""
        newest = self._change
        return newest is not change and newest is not None and newest.parameters != change.parameters

    def comes_within(self, seconds: float) -> bool:
        """Wait so long for a change that was not taken yet, and return whether there is one."""
        with self._has_changed:
            return self._has_changed.wait_for(lambda: not self._is_taken, seconds)


def refine_newest(refinement: Refinement, newest: Newest, send: OnMessage) -> None:
    """Take the newest change, and send answers to it, better and better, until it is done or superseded."""
    change = newest.take()
    try:
        if not refinement.is_prepared_for(change.parameters):
            if newest.comes_within(QUIET):
                return
            send(Note("doing", "settles the neutral face and its derivatives", change.number))
            send(refinement.prepare(change.parameters, lambda: newest.is_another_face(change)))
        for frame in refinement.frames(change, lambda: newest.is_another(change)):
            send(frame)
    except SupersededError:
        return
    except SoftdecaError as error:
        send(Note("failed", str(error), change.number))


def work(connection: Connection) -> None:
    """Refine what comes by the connection, first the face, then changes, until it ends."""
    os.nice(5)  # first answers go before better ones
    try:
        face: Face = connection.recv()
    except (EOFError, OSError):
        return
    newest = Newest()
    threading.Thread(target=_listen, args=(connection, newest), daemon=True).start()
    with threadpool_limits(1), suppress(OSError):  # the server is gone
        refinement = Refinement(face)
        while True:
            refine_newest(refinement, newest, connection.send)


def _listen(connection: Connection, newest: Newest) -> None:
    try:
        while True:
            newest.put(connection.recv())
    except (EOFError, OSError):
        os._exit(0)


class Worker:
    """The refining process of a tab, as the server sees it.

    `on_message` and `on_end`, which tells that it ended by itself, are called by a thread of its own.
    """

    def __init__(self, face: Face, on_message: OnMessage, on_end: Callable[[], None]):
        self._face, self._on_message, self._on_end = face, on_message, on_end
        self._starting, self._sending = threading.Lock(), threading.Lock()
        self.is_over = False
        """Set where no process is to be started any more."""
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._connection: Connection | None = None  # once the face is sent

    def start(self) -> None:
        """Start the process and send it the face, which takes seconds; nothing if it is over before."""
        with self._starting:
            if self.is_over:
                return
            context = multiprocessing.get_context("spawn")
            mine, its = context.Pipe()
            process = context.Process(target=work, args=(its,), name="refining", daemon=True)
            # Ctrl-C goes to every process of a terminal; this one ends with its pipe.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                process.start()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
            its.close()
            self._process, self._pipe = process, mine
        with self._sending, suppress(OSError):  # as an argument it would block forever if the process died meanwhile
            mine.send(self._face)
            self._connection = mine
        threading.Thread(target=self._receive, args=(mine,), daemon=True).start()

    def ask(self, change: Change) -> None:
        """Refine this change from now on; nothing if the process has not started or is over."""
        if self._connection is not None:
            with self._sending, suppress(OSError):  # it may be over, which `on_end` tells
                self._connection.send(change)

    def end(self) -> None:
        """End the process, whatever it is doing, and wait until it is gone."""
        self.is_over = True
        with self._starting:
            if self._process is None or self._pipe is None:
                return
            self._process.kill()
            self._process.join()
            with self._sending:
                self._pipe.close()

    def _receive(self, connection: Connection) -> None:
        try:
            while True:
                self._on_message(connection.recv())
        except (EOFError, OSError):
            pass
        finally:
            if not self.is_over:
                self.end()
                self._on_end()
