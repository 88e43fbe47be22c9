"""The shell of verbs: ``zmav VERB``. One verb a file; packages above the library add theirs by entry points."""

from __future__ import annotations

import atexit
import os
import signal
import sys

import click

from zmav.cli.common import Verbs
from zmav.errors import ZmavError

VERBS = (
    "agent",
    "sim",
    "ls",
    "echo",
    "hz",
    "rate",
    "do",
    "command",
    "goto",
    "fly",
    "mission",
    "get",
    "ftp",
    "log",
    "send",
    "signing",
    "install",
    "doctor",
    "param",
    "terrain",
    "gimbal",
)


@click.group(
    cls=Verbs,
    package="zmav.cli",
    files=VERBS,
    points="zmav.verbs",
    invoke_without_command=True,
    no_args_is_help=True,
    subcommand_metavar="COMMAND [ARGS]...",
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--version", is_flag=True, help="Show the version and exit; with --json, of all that others rely on.")
@click.option("--json", "as_json", is_flag=True, hidden=True)
@click.pass_context
def zmav(ctx: click.Context, version: bool, as_json: bool) -> None:
    """One key space for a swarm of vehicles: MAVLink over Zenoh.

    'zmav demo' flies three simulated copters; 'zmav up' runs beside an autopilot; 'zmav ls' shows who is there.
    """
    if version:
        from zmav.cli.version import show  # beside what it has to load

        show(as_json)
        ctx.exit()
    if as_json or ctx.invoked_subcommand is None:
        raise click.UsageError("--json goes with --version here, and else behind a verb")


def main() -> None:
    """The ``zmav`` program: 0 done, 1 an error that is said, 2 wrong usage, 130 interrupted."""
    # Before numpy is loaded, here and in processes that are started from here. Its matrices are small in zmav: further
    # threads do nothing for them, but wait for the next one by turning, which takes a helipad's agent half of its time.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    code = 1  # of an exception that nobody catches

    def end() -> None:
        if "zenoh" in sys.modules:
            from zmav.process import leave  # beside what it has to load

            leave(code)

    atexit.register(end)  # before all that the verb registers, so that it comes last
    try:
        code = _code()
        _end_at_once()
    except KeyboardInterrupt:  # while an error is said
        _end_at_once()
        code = 130
    sys.exit(code)


def _end_at_once() -> None:
    """From now on Ctrl-C ends the process without a word: the verb has ended, and Python would print where it is."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else who started us had it ignored
        signal.signal(signal.SIGINT, signal.SIG_DFL)


def _code() -> int:
    try:
        code = zmav(standalone_mode=False)
    except click.ClickException as e:
        e.show()
        return e.exit_code
    except ZmavError as e:
        click.echo(f"zmav: {e}", err=True)
        return 1
    except (click.Abort, KeyboardInterrupt):
        return 130
    except SystemExit as e:
        if isinstance(e.code, str):
            click.echo(e.code, err=True)
            return 1
        code = e.code
    return code if isinstance(code, int) else 0
