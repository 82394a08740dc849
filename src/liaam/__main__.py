"""The command ``liaam``, which is ``python -m liaam`` too."""

import _thread
import signal
import sys
import threading
from typing import Any


def main() -> None:
    """Run the command line; a Ctrl-C at any time ends it without a traceback."""
    sys.unraisablehook = _on_unraisable
    try:
        from liaam.cli.terminal import warnings_as_lines

        with warnings_as_lines():  # also that the compiled core is missing, which its import says
            from liaam.cli.main import main as run  # takes a moment
        run()
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        sys.exit(130)
    finally:
        if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as under nohup
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback while Python ends


def _on_unraisable(what: Any) -> None:
    """Repeat a Ctrl-C that came where Python lets nothing be raised, such as in a callback of an import."""
    if issubclass(what.exc_type, KeyboardInterrupt):
        threading.Timer(0.01, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(what)


if __name__ == "__main__":
    main()
