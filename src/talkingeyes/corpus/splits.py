"""The fixed split of a corpus: some speakers are unseen, the sounds of the others are train, val and test, grouped by
sound and sentence. A corpus of one person is split in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

HELD_OUT = 0.1  # of one person, for val and for test


def split_sounds(
    speaker_of: Mapping[str, str],
    sentences_of: Mapping[str, Sequence[str]],
    seed: int,
    *,
    unseen_speakers: float = 0.15,
    val: float = 0.1,
    test: float = 0.1,
) -> dict[str, str]:
    """Split of each sound; `unseen_speakers` is a fraction of the speakers, `val` and `test` of the other speakers'
    sounds. The defaults are the 8:1:1 of TalkingEyes (section III-A), which has no unseen speakers.

    Among the seen speakers, sounds that have a sentence in common stay together. These groups go, largest first, to the
    split furthest below its target size, so a corpus of few sentences still gets all three splits. The other sounds are
    distributed speaker by speaker.
    """
    rng = np.random.default_rng(seed)
    speakers = sorted(set(speaker_of.values()))
    count = round(unseen_speakers * len(speakers)) if len(speakers) > 1 else 0
    unseen = set(rng.choice(speakers, size=max(count, int(len(speakers) > 1)), replace=False))
    split = {sound: "unseen" for sound, speaker in speaker_of.items() if speaker in unseen}
    groups = _groups({sound: sentences_of[sound] for sound in speaker_of if sound not in split})
    rng.shuffle(groups)
    groups.sort(key=len, reverse=True)
    sizes = {"train": 1 - val - test, "val": val, "test": test}
    sizes = {name: size * sum(map(len, groups)) for name, size in sizes.items()}
    filled = dict.fromkeys(sizes, 0)
    single = sorted((group[0] for group in groups if len(group) == 1), key=lambda sound: speaker_of[sound])
    for group in groups[: len(groups) - len(single)]:
        name = max(sizes, key=lambda each: sizes[each] - filled[each])
        filled[name] += len(group)
        split.update(dict.fromkeys(group, name))
    wanted = {name: max(size - filled[name], 0.0) for name, size in sizes.items()}
    return split | _distribute(single, wanted)


def split_in_time(seconds: Mapping[str, float]) -> dict[str, str]:
    """Split of one person's sounds, given with their lengths in the order of recording: train, then val, then test, a
    tenth each.

    A sound belongs to the split of its middle; of three sounds or more, each split has at least one.
    """
    lengths = np.array(list(seconds.values()))
    middles = (np.cumsum(lengths) - lengths / 2) / lengths.sum()
    val_from, test_from = np.searchsorted(middles, [1 - HELD_OUT - HELD_OUT, 1 - HELD_OUT])
    if len(lengths) >= 3:
        val_from = min(val_from, len(lengths) - 2)
        test_from = min(max(test_from, val_from + 1), len(lengths) - 1)
    return {
        sound: "train" if place < val_from else "val" if place < test_from else "test"
        for place, sound in enumerate(seconds)
    }


def _distribute(sounds: Sequence[str], wanted: Mapping[str, float]) -> dict[str, str]:
    """Distribute sounds in the order of their speakers, so that every speaker is in each split if possible."""
    split: dict[str, str] = {}
    given = dict.fromkeys(wanted, 0)
    per_sound = {name: count / max(sum(wanted.values()), 1e-9) for name, count in wanted.items()}
    for index, sound in enumerate(sounds):
        name = max(wanted, key=lambda each: per_sound[each] * (index + 1) - given[each])
        given[name] += 1
        split[sound] = name
    return split


def _groups(sentences_of: Mapping[str, Sequence[str]]) -> list[list[str]]:
    """Sounds connected by common sentences (union-find over sentences)."""
    parent = {sound: sound for sound in sentences_of}

    def root(sound: str) -> str:
        while parent[sound] != sound:
            parent[sound] = parent[parent[sound]]
            sound = parent[sound]
        return sound

    owner: dict[str, str] = {}
    for sound, sentences in sentences_of.items():
        for sentence in sentences:
            parent[root(sound)] = root(owner.setdefault(sentence, sound))
    groups: dict[str, list[str]] = {}
    for sound in sentences_of:
        groups.setdefault(root(sound), []).append(sound)
    return list(groups.values())
