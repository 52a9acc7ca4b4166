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
                    return _interrupted()
                raise
            return _interrupted() if interrupts.received else code
    except KeyboardInterrupt:
        return _interrupted()


def _interrupted() -> int:
    """Of what had not come so far that it could say so itself."""
    print("interrupted", file=sys.stderr)
    return INTERRUPTED


if __name__ == "__main__":
    sys.exit(entry())
