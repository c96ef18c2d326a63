"""The one error that a person can mend: shown as one line, exit status 2."""


class InputError(ValueError):
    """Bad input or configuration. The message says what is wrong and what would be right, in one line."""
