"""Work for a second thread: what follows from a run but does not steer it, done while ticks run."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Self

_ROOM = 16  #: pieces of work that may wait

Work = Callable[[], object]


class Behind:
    """A thread that does what it is given in that order; to be used by ``with``, from one thread.

    Leaving ends it once all is done, but for work after a failure, which is left out.  A failure is raised
    by the next :meth:`do` or :meth:`wait`.
    """

    def __init__(self) -> None:
        self._failure: Exception | None = None
        self._work: SimpleQueue[Work | None] = SimpleQueue()
        # One entry for each piece that may yet be given: both queues are C code, without locks in Python.
        self._room: SimpleQueue[None] = SimpleQueue()
        for _ in range(_ROOM):
            self._room.put(None)
        self._thread = threading.Thread(target=self._run, name="behind", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._work.put(None)
        self._thread.join()

    def do(self, work: Work) -> None:
        """Give work; wait where too much of it waits already."""
        self._room.get()
        self._work.put(work)
        self._tell()

    def wait(self) -> None:
        """Wait until all that was given is done."""
        for _ in range(_ROOM):
            self._room.get()
        for _ in range(_ROOM):
            self._room.put(None)
        self._tell()

    def _tell(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        while (work := self._work.get()) is not None:
            try:
                if self._failure is None:
                    work()
            except Exception as error:  # noqa: BLE001 - such as no memory; told to who gave it
                self._failure = error
            finally:
                self._room.put(None)
