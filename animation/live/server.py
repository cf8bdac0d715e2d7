"""The server of the live page: one page and one websocket, for browsers of this machine alone.

It listens on 127.0.0.1 and answers requests whose Host is that address or localhost (a name that somebody else's DNS
turns towards this machine is another one), and websockets whose Origin is its own page.
"""

from __future__ import annotations

import asyncio
import logging
import signal
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from threadpoolctl import threadpool_limits

from ...lhm.base.errors import InputError, MissingDependencyError, SoftdecaError
from ...lhm.base.limits import CHANGE_BYTES, CHANGES_PER_SECOND, PORT, TABS
from ...reference import Face
from ...surrogate import Surrogate
from .face import FirstAnswer
from .messages import Change, DerivativesFound, Frame, Note, pack_frame, read_change
from .page import render_live_page
from .worker import Message, Worker

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

HOST = "127.0.0.1"
SOCKET = "/changes"
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; connect-src 'self' {}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Content-Security-Policy of the page: it has all within itself, and talks to its websocket alone."""
TOO_MUCH, TRY_LATER = 1008, 1013
"""Close codes of RFC 6455: a policy is broken; the server is full."""
UNCHANGED = '{"change": 0, "weights": {}, "parameters": {}}'


def serve_face(
    face: Face,
    title: str,
    network: Surrogate,
    *,
    detail: bool = False,
    port: int | None = None,
    on_ready: Callable[[str], None],
    on_trouble: Callable[[str], None],
) -> None:
    """Serve the page of a face until Ctrl-C, SIGTERM or SIGHUP; then every process of its own has ended.

    network: of the first answers. detail: whether the page draws the head's fine skin. port: a free one by default.
    `on_ready` is given the address, `on_trouble` a line for each defect. Raises InputError for a port that is taken,
    and MissingDependencyError without websockets.
    """
    try:
        import websockets  # noqa: F401
    except ModuleNotFoundError:
        raise MissingDependencyError(
            "a live page needs websockets: pip install 'softdeca[view]', or export one by --out FILE.html"
        ) from None
    if port is not None:
        PORT.check("port", port)
    with threadpool_limits(1):
        asyncio.run(_Server(face, title, network, detail, on_trouble).run(port, on_ready))


class _Server:
    """The page, the tabs that are open, and the one thread that makes their first answers."""

    def __init__(self, face: Face, title: str, network: Surrogate, detail: bool, on_trouble: Callable[[str], None]):
        self.face, self.on_trouble = face, on_trouble
        self.first = FirstAnswer(face, network)
        self.thread = ThreadPoolExecutor(1, thread_name_prefix="first answers")
        self._page = render_live_page(title, face, network, SOCKET, detail).encode()
        self._tabs: set[_Tab] = set()
        self._hosts: tuple[str, ...] = ()

    async def run(self, port: int | None, on_ready: Callable[[str], None]) -> None:
        """Serve until a signal comes; `on_ready` gets the address. InputError if `port` (None: a free one) is taken."""
        from websockets.asyncio.server import serve

        loop, stopped = asyncio.get_running_loop(), asyncio.Event()
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            with suppress(NotImplementedError, AttributeError):  # systems without
                loop.add_signal_handler(getattr(signal, name), stopped.set)
        # Compiled code is loaded before somebody waits for it.
        await self.in_thread(self.first.frame, read_change(UNCHANGED, self.face.parameters))
        silent = logging.Logger("softdeca.animation.live", logging.CRITICAL)  # strangers' broken handshakes are no news
        try:
            serving = await serve(
                self._handle, HOST, port or 0, process_request=self._answer, max_size=CHANGE_BYTES.most,
                compression=None, close_timeout=5.0, server_header=None, logger=silent,
            )  # fmt: skip
        except OSError as error:
            raise InputError(f"port {port}: cannot listen on {HOST} ({error.strerror or error})") from None
        async with serving:
            found = serving.sockets[0].getsockname()[1]
            self._hosts = (f"{HOST}:{found}", f"localhost:{found}")
            on_ready(f"http://{HOST}:{found}/")
            await stopped.wait()
        self.thread.shutdown(cancel_futures=True)

    async def in_thread(self, work: Callable, *arguments: Any) -> Any:
        """Run in the one thread of first answers."""
        return await asyncio.get_running_loop().run_in_executor(self.thread, work, *arguments)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Give the page, or a refusal in one line; None lets a websocket go on."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        own = [f"http://{host}" for host in self._hosts]
        is_socket = request.path == SOCKET
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return connection.respond(HTTPStatus.MISDIRECTED_REQUEST, f"Host: expected {' or '.join(self._hosts)}\n")
        if (is_socket or origins) and (len(origins) != 1 or origins[0] not in own):
            return connection.respond(HTTPStatus.FORBIDDEN, f"Origin: expected {' or '.join(own)}\n")
        if is_socket:
            return None
        if request.path != "/":
            return connection.respond(HTTPStatus.NOT_FOUND, "there is one page, /\n")
        response = connection.respond(HTTPStatus.OK, "")
        response.body = self._page
        for name in ("Content-Type", "Content-Length"):
            del response.headers[name]
        response.headers.update({
            "Content-Type": "text/html; charset=utf-8",
            "Content-Length": str(len(self._page)),
            "Content-Security-Policy": POLICY.format(" ".join(f"ws://{host}" for host in self._hosts)),
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cross-Origin-Opener-Policy": "same-origin",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
        })  # fmt: skip
        return response

    async def _handle(self, socket: ServerConnection) -> None:
        if sum(tab.is_open for tab in self._tabs) >= TABS.most:
            await socket.close(TRY_LATER, f"{TABS.most} tabs are open, which is the most; close one")
            return
        tab = _Tab(self, socket)
        self._tabs.add(tab)
        try:
            await tab.run()
        finally:
            self._tabs.discard(tab)


class _Tab:
    """One websocket: the newest change, its first answer, and what the refining process makes of it."""

    def __init__(self, server: _Server, socket: ServerConnection):
        self._server, self._socket = server, socket
        self._loop = asyncio.get_running_loop()
        self._wake = asyncio.Event()
        self._newest: Change | None = None
        self._to_answer: Change | None = None
        self._better: Frame | None = None
        self._found: DerivativesFound | None = None
        self._notes: deque[Note] = deque(maxlen=8)  # that wait for a slow browser
        self._worker = self._make_worker()
        self._starting: asyncio.Task[None] | None = None

    @property
    def is_open(self) -> bool:
        """Whether its socket is; a tab that was closed may still wait for its process to end."""
        from websockets.protocol import State

        return self._socket.state is State.OPEN

    async def run(self) -> None:
        """Serve the tab until it closes; then its process has ended."""
        from websockets.exceptions import ConnectionClosed

        tasks = [asyncio.create_task(work) for work in (self._receive(), self._send())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            errors = [error for task in done if (error := task.exception()) is not None]
            for error in errors:
                if not isinstance(error, ConnectionClosed):  # a defect: this tab ends, others go on
                    self._server.on_trouble(f"a tab ended: {type(error).__name__}: {error}")
        finally:
            self._worker.is_over = True  # at once; `end` may wait for a thread
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await asyncio.to_thread(self._worker.end)

    async def _receive(self) -> None:
        """Read changes, the newest replacing those before; refuse in one line what is none, and close a flood."""
        allowed, last = float(CHANGES_PER_SECOND.most), time.monotonic()
        async for message in self._socket:
            now = time.monotonic()
            allowed = min(allowed + (now - last) * CHANGES_PER_SECOND.most, CHANGES_PER_SECOND.most) - 1.0
            last = now
            if allowed < 0.0:
                await self._socket.close(TOO_MUCH, f"more than {CHANGES_PER_SECOND.most} changes in a second")
                return
            try:
                self._newest = self._to_answer = read_change(message, self._server.face.parameters)
                self._better = None
            except SoftdecaError as error:
                self._notes.append(Note("refused", str(error)))
            self._wake.set()

    async def _send(self) -> None:
        """Answer the newest change at once, then send on what is better, and notes."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._notes:
                await self._socket.send(self._notes.popleft().to_json())
            if self._to_answer is not None:
                change, self._to_answer = self._to_answer, None
                await self._answer(change)
                self._start_worker()
                await asyncio.to_thread(self._worker.ask, change)
            if self._found is not None:
                found, self._found = self._found, None
                await self._server.in_thread(self._server.first.learn, found)
                if self._newest is not None and self._newest.parameters == found.parameters:
                    await self._answer(self._newest)
            if self._better is not None:
                frame, self._better = self._better, None
                await self._send_frame(frame)

    async def _answer(self, change: Change) -> None:
        """Send the first answer to a change."""
        try:
            frame = await self._server.in_thread(self._server.first.frame, change)
        except SoftdecaError as error:
            await self._socket.send(Note("failed", str(error), change.number).to_json())
            return
        await self._send_frame(frame)

    async def _send_frame(self, frame: Frame) -> None:
        """Send a frame, if it is of the newest change."""
        if self._newest is not None and frame.change == self._newest.number:
            blended = self._server.face.blend(self._newest.weights)
            await self._socket.send(pack_frame(frame, blended))

    def _take(self, message: Message) -> None:
        """Keep what the refining process says until it is sent: of frames the newest."""
        if isinstance(message, DerivativesFound):
            self._found = message
        elif self._newest is None or message.change != self._newest.number:
            return
        elif isinstance(message, Frame):
            self._better = message
        else:
            self._notes.append(message)
        self._wake.set()

    def _make_worker(self) -> Worker:
        """Make the refining process' other side, whose messages come by a thread of its own."""

        def soon(callback: Callable, *arguments: Any) -> None:
            with suppress(RuntimeError):  # the loop is over, and with it the tab
                self._loop.call_soon_threadsafe(callback, *arguments)

        return Worker(self._server.face, lambda message: soon(self._take, message), lambda: soon(self._has_crashed))

    def _start_worker(self) -> None:
        """Start the refining process if it does not run, and ask it for the newest change."""

        async def start(worker: Worker) -> None:
            try:
                await asyncio.to_thread(worker.start)
            except OSError as error:
                self._notes.append(Note("failed", f"no process for better answers: {error}"))
                self._wake.set()
            if self._newest is not None:
                await asyncio.to_thread(worker.ask, self._newest)

        if self._starting is None:
            self._starting = asyncio.create_task(start(self._worker))

    def _has_crashed(self) -> None:
        """Tell that the refining process has ended by itself; the next change starts another."""
        number = None if self._newest is None else self._newest.number
        self._notes.append(Note("failed", "the refining process has ended; the next change starts another", number))
        self._worker, self._starting = self._make_worker(), None
        self._wake.set()
