"""The lab's one process that holds all namespaces and moves all frames: ``python -m mesh.lab.relay FD``.

It is the first process of a PID namespace in which everything else of the lab runs. So when it ends, for whatever
reason, the kernel kills all of that; with its descriptors go the interfaces and the network namespaces; and it ends
when the lab's end of its socket closes, which the kernel does however the lab ends. Nothing has a name in the system.

It imports little, and a single thread does everything: frames are few (thousands a second) and their order matters.
"""

from __future__ import annotations

import contextlib
import gc
import os
import resource
import select
import shutil
import signal
import socket
import sys
import time
from pathlib import Path

from mesh.lab import kernel, messages
from mesh.lab.switchboard import RelayNetwork

EARLY_S = 50e-6
"""a frame that is due so soon arrives now: to be woken once more for it would cost as much"""


def main() -> None:
    """Become the first process of a new PID namespace and serve the lab on the socket ``argv[1]``."""
    kernel.unshare(kernel.CLONE_NEWPID)
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))  # two for each host, and one for each interface
    gc.disable()  # nothing here makes cycles, and frames come by the million
    child = os.fork()
    if child:
        os.close(int(sys.argv[1]))
        sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    kernel.die_with_parent(signal.SIGKILL)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # orphans of the PID namespace become our children
    with socket.socket(fileno=int(sys.argv[1])) as lab, contextlib.suppress(EOFError, ConnectionError):
        serve(lab)


def serve(lab: socket.socket) -> None:
    """Do what the lab says until it has gone (:class:`EOFError`); then leave nothing behind."""
    begin = messages.read_request(lab)
    assert isinstance(begin, messages.Begin)
    try:
        board = RelayNetwork(begin)
        pid = int(str(Path("/proc/self").readlink()))  # as those outside our PID namespace call us: /proc is theirs
        messages.write(lab, messages.Begun(pid, board.networks))
        run(lab, board)
    except OSError as e:
        messages.write(lab, messages.Failed(e.errno or 0, e.strerror or str(e)))
    finally:
        if os.getpid() == 1:  # in a PID namespace of our own, and so these are all in it: nobody writes any more
            with contextlib.suppress(OSError):
                os.kill(-1, signal.SIGKILL)
        if begin.directory is not None:
            shutil.rmtree(begin.directory, ignore_errors=True)


def run(lab: socket.socket, board: RelayNetwork) -> None:
    """Move frames and answer the lab, for ever."""
    timer, poll, armed = kernel.Timer(), select.epoll(), 0.0
    taps = {tap.fd: tap for tap in board.taps}
    for fd in (lab.fileno(), timer.fd, *taps):
        poll.register(fd, select.EPOLLIN)
    agenda, monotonic, read = board.agenda, time.monotonic, os.read
    while True:
        due = agenda.next()
        if due is not None and due != armed:
            timer.arm(due)
            armed = due
        for fd, _ in poll.poll():
            tap = taps.get(fd)
            if tap is not None:
                # One frame and no more: to learn that there is none costs an exception, dearer than being told again.
                try:
                    tap.send(read(fd, tap.largest), monotonic())
                except BlockingIOError:
                    pass
                except OSError:  # somebody deleted the interface in its namespace
                    poll.unregister(fd)
            elif fd != timer.fd:
                messages.write(lab, board.answer(messages.read_request(lab)))
        agenda.run(monotonic() + EARLY_S)
        if agenda.next() is None and armed:
            timer.disarm()
            armed = 0.0


if __name__ == "__main__":
    main()
