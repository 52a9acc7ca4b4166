"""The console script `dualslam`: ready for Ctrl-C and SIGTERM before anything that takes time is loaded."""

import sys

INTERRUPTED = 130


def entry(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code: 0 done, 2 unusable arguments or input, 130 interrupted."""
    try:
        from app.interrupt import Interrupts

        with Interrupts() as interrupts:
            with interrupts.shield():  # a library answers an interruption of its loading with errors of its own
                from app.command import carry_out
            try:
                code = carry_out(sys.argv[1:] if arguments is None else arguments)
            except Exception:
                if interrupts.received:  # a library made an error of the interruption
                    return INTERRUPTED
                raise
            return INTERRUPTED if interrupts.received else code
    except KeyboardInterrupt:
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(entry())
