"""Names of clips, sounds and speakers that are valid for files: no separators, no spaces, no leading dot."""

from __future__ import annotations

import hashlib
import re
import unicodedata

FILE_NAME = re.compile(r"\w[\w.+-]*")
MAX_LENGTH = 48


def unique_file_name(words: str, name: str) -> str:
    """The letters and digits of any script in `words`, and six digits of a hash of `name`, which keep it unique."""
    plain = re.sub(r"\W+", "-", unicodedata.normalize("NFKC", words))[-MAX_LENGTH:].strip("-")
    digits = hashlib.blake2b(name.encode(), digest_size=3).hexdigest()
    return f"{plain}-{digits}" if plain else digits
