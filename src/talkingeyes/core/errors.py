"""The one error that a user can fix: shown as one line, exit status 2."""

MAX_LETTERS = 290  # of a message
MAX_LOCATION = 200  # letters of its location: a path or key, before the first colon
TAIL_LETTERS = 60  # a hint often stands at the end


class InputError(ValueError):
    """Bad input or configuration. The message states the problem and the expected value in one line.

    Messages quote files, which can be long and hold control characters: location and text are cut in the middle, to
    MAX_LETTERS in all, and what cannot be printed becomes U+FFFD.
    """

    def __init__(self, message: str) -> None:
        location, colon, text = message.partition(": ")
        location = _shorten(location, MAX_LOCATION if colon else MAX_LETTERS)
        super().__init__(f"{location}{colon}{_shorten(text, MAX_LETTERS - len(location) - len(colon))}")


def _shorten(text: str, most: int) -> str:
    if len(text) > most:
        text = f"{text[: most - TAIL_LETTERS - 3]}...{text[-TAIL_LETTERS:]}"
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in " ".join(text.split()))
