"""The one error that a user can fix: shown as one line, exit status 2."""

MAX_LETTERS = 200  # of the location (a path or key, before the first colon), and of the text after it
TAIL_LETTERS = 60  # a hint often stands at the end


class InputError(ValueError):
    """Bad input or configuration. The message states the problem and the expected value in one line.

    Messages quote files, which can be long and hold control characters: location and text are cut in the middle to
    MAX_LETTERS each, and what cannot be printed becomes U+FFFD.
    """

    def __init__(self, message: str) -> None:
        location, colon, text = message.partition(": ")
        super().__init__(f"{_shorten(location)}{colon}{_shorten(text)}")


def _shorten(text: str) -> str:
    if len(text) > MAX_LETTERS:
        text = f"{text[: MAX_LETTERS - TAIL_LETTERS - 3]}...{text[-TAIL_LETTERS:]}"
    return "".join(letter if letter.isprintable() else "\ufffd" for letter in " ".join(text.split()))
