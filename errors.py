"""The exceptions a user can meet. Each carries one line: what is wrong, with its value, and what to do."""


class BssrdfError(Exception):
    """Root of every error this package raises on purpose; `exit_code` is what the command line returns."""

    exit_code = 1


class UsageError(BssrdfError):
    """The call itself is wrong: an option, a name, an output that exists."""

    exit_code = 2


class InputError(BssrdfError):
    """A file or a value that was given cannot be used."""

    exit_code = 3


class DeviceError(BssrdfError):
    """A device of the rig failed; the shutter was closed first."""

    exit_code = 4
