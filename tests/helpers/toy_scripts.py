"""Scripts of generated sentences."""

import numpy as np

from talkingeyes.synthesis.text import (
    SHORTEST_SENTENCE_S,
    Script,
    Sentence,
    estimated_duration_s,
    without_last_pause,
    write_sentence,
)


def write_script(language: str, seconds: float, rng: np.random.Generator) -> Script:
    """Sentences that take about `seconds` at the usual rate, at least one."""
    sentences: list[Sentence] = []
    remaining_s = seconds
    while not sentences or remaining_s > SHORTEST_SENTENCE_S:
        sentences.append(write_sentence(language, remaining_s, rng))
        remaining_s -= estimated_duration_s(sentences[-1])
    sentences[-1] = without_last_pause(sentences[-1])
    return Script(language, tuple(sentences))
