"""Takes of a synthetic corpus regenerated from their seeds, at other frame rates and in greater number.

The same seeds give the same events, so a corpus at 25 fps can be measured as if it had been rendered at 500 fps.
"""

from __future__ import annotations

import numpy as np

from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus
from talkingeyes.evaluation.detectors.behaviour import behaviour
from talkingeyes.evaluation.measures import blinks, saccades
from talkingeyes.evaluation.measures.pooled import join_pools
from talkingeyes.evaluation.reference_ranges import measurements
from talkingeyes.evaluation.reference_ranges.measurements import RATES_FPS
from talkingeyes.synthesis import plan
from talkingeyes.synthesis.take import Take, sample_take

FURTHER_TAKES = range(1000, 1004)


def sound_of(settings: plan.SynthesizeSettings, clip: Clip) -> plan.PlannedSound:
    """The planned sound of a clip."""
    return plan.plan_sound(settings, int(clip.sound.rsplit("-", 1)[1]))


def regenerate_take(corpus: Corpus, settings: plan.SynthesizeSettings, clip: Clip, take: int) -> Take:
    """Regenerate a take of a clip's sound from its seeds, of the corpus or a further one."""
    sound = sound_of(settings, clip)
    rng = plan.seeded_generator(settings.seed, "motion", sound.index, take)
    style = plan.speaker_of(settings, sound).style
    return sample_take(corpus.conversation(clip), style, clip.seconds, rng, settings.blink_profile)


def reproduce_take(corpus: Corpus, settings: plan.SynthesizeSettings, clip: Clip) -> Take:
    """Regenerate the take of a clip. Raises InputError if it differs from that of the corpus."""
    take = regenerate_take(corpus, settings, clip, clip.take)
    if take.events != corpus.truth_events(clip):
        raise InputError(
            f"{clip.id}: should have the regenerated events, got others; the corpus is from other settings or code"
        )
    return take


def extract_further_takes(corpus: Corpus, settings: plan.SynthesizeSettings, clip: Clip) -> dict[str, np.ndarray]:
    """Large gaze shifts of takes outside the corpus, which has too few of them for an estimate."""
    found = []
    for number in FURTHER_TAKES:
        take = regenerate_take(corpus, settings, clip, number)
        motion = take.motion(clip.fps, int(clip.seconds * clip.fps))
        fields = {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}
        found.append(measurements.extract_gaze_shifts(behaviour(motion.fps, fields, motion.valid)))
    return join_pools(found)


def extract_frame_rates(corpus: Corpus, settings: plan.SynthesizeSettings, clip: Clip) -> dict[str, np.ndarray]:
    """Saccades of a take at all frame rates, and its blinks at the highest."""
    take = reproduce_take(corpus, settings, clip)
    pool: dict[str, np.ndarray] = {}
    finest = None
    for fps in RATES_FPS:
        motion = take.motion(float(fps), int(clip.seconds * fps))
        seen = behaviour(motion.fps, {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid})
        found = saccades.detect_rendered(seen)
        finest = found if finest is None else finest
        pool |= saccades.extract_at_rate(f"at{fps}", seen, found)
        pool |= saccades.match_frame_rates(f"same{fps}", finest, found)
        if fps == RATES_FPS[0]:
            pool |= blinks.extract_kinematics(seen)
    return pool
