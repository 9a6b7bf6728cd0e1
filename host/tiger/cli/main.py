"""Entry point of `tiger`. Ctrl-C ends it quietly from here on: what imports for long is inside `main`."""

from __future__ import annotations

import sys

INTERRUPTED = 130
"""Exit status after Ctrl-C: 128 and the number of the signal, as shells have it."""


def main() -> None:
    """Do what the command line asks for, and leave with its status."""
    try:
        from tiger.cli.commands import obey

        obey()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    finally:
        _let_go()


def _let_go() -> None:
    """What is left is Python's own end, which tells of every Ctrl-C with a traceback: the kernel does not."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)


if __name__ == "__main__":
    main()
