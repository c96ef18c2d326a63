"""The one error that a user can fix: shown as one line, exit status 2."""


class InputError(ValueError):
    """Bad input or configuration. The message states the problem and the expected value in one line."""
