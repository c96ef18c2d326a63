"""The fixed split of a corpus: 15 % of the speakers are unseen, the rest 8:1:1, grouped by sound and sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

UNSEEN_SPEAKER_RATIO = 0.15
SPLIT_RATIOS = {"train": 0.8, "val": 0.1, "test": 0.1}


def split_sounds(speaker_of: Mapping[str, str], sentences_of: Mapping[str, Sequence[str]], seed: int) -> dict[str, str]:
    """Split of each sound.

    Among the seen speakers, sounds that have a sentence in common stay together. These groups go, largest first, to the
    split furthest below its target size, so a corpus of few sentences still gets all three splits. The other sounds are
    distributed speaker by speaker.
    """
    rng = np.random.default_rng(seed)
    speakers = sorted(set(speaker_of.values()))
    count = round(UNSEEN_SPEAKER_RATIO * len(speakers)) if len(speakers) > 1 else 0
    unseen = set(rng.choice(speakers, size=max(count, int(len(speakers) > 1)), replace=False))
    split = {sound: "unseen" for sound, speaker in speaker_of.items() if speaker in unseen}
    groups = _groups({sound: sentences_of[sound] for sound in speaker_of if sound not in split})
    rng.shuffle(groups)
    groups.sort(key=len, reverse=True)
    total = sum(map(len, groups))
    filled = dict.fromkeys(SPLIT_RATIOS, 0)
    single = sorted((group[0] for group in groups if len(group) == 1), key=lambda sound: speaker_of[sound])
    for group in groups[: len(groups) - len(single)]:
        name = max(SPLIT_RATIOS, key=lambda each: SPLIT_RATIOS[each] * total - filled[each])
        filled[name] += len(group)
        split.update(dict.fromkeys(group, name))
    wanted = {name: max(SPLIT_RATIOS[name] * total - filled[name], 0.0) for name in SPLIT_RATIOS}
    return split | _distribute(single, wanted)


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
