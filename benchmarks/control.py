"""Accuracy of controls: targets, eye contact, liveliness, styles, dialogue; and visibility of encoder windows.

The packaged recording (44 s) is animated by the default model. The dialogue consists of its parts, assigned to two
people in turn, or of the given sounds, also in turn. Everything is measured on the generated motion. Windows: the speed
of head and gaze around the seams of the encoder's windows relative to the speed elsewhere, compared with the same ratio
around equally spaced times between the seams.

Run     python -m benchmarks.control [FOLDER OF A MODEL [SOUND SOUND ...]]   (make bench, after make repro; a minute)
Reads   data/train/talkingeyes_events, or the given folder; with sounds, only the dialogue is measured
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from talkingeyes.animation import line_of_sight
from talkingeyes.animation.animation import Animation
from talkingeyes.animation.animator import Animator
from talkingeyes.animation.controls import Controls, Liveliness
from talkingeyes.animation.steps.eye_contact import eye_contact_fraction
from talkingeyes.animation.targets import ObjectTrack, Target, TargetTrack
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.audio.encoder_moonshine import EXAMPLE_SPEECH, package_file
from talkingeyes.audio.turn_taking import detect_turns
from talkingeyes.audio.waveform import SAMPLE_RATE, read_speech
from talkingeyes.audio.windows import window_starts
from talkingeyes.core import rotation
from talkingeyes.core.kinematics import gaze_in_space_speed_deg_s, head_speed_deg_s
from talkingeyes.core.motion import Motion
from talkingeyes.fitting.motion_style import MotionStyle, measure_style
from talkingeyes.orchestration.run import run_command
from talkingeyes.physiology import saccades
from talkingeyes.physiology.blinks import PARTNER_END_S

MODEL = Path("data", "train", "talkingeyes_events")
SAMPLES = 4
PLAIN = Controls()
TARGETS_M = {
    "near": ObjectTrack.fixed(0.05, -0.1, 0.35),
    "ahead": ObjectTrack.fixed(0.0, 0.0, 1.0),
    "left, up": ObjectTrack.fixed(0.9, 0.3, 1.2),
    "right": ObjectTrack.fixed(-1.5, 0.0, 1.5),
    "far right": ObjectTrack.fixed(-3.0, -0.2, 1.0),
    "moving": ObjectTrack((1.0, 40.0), ((-1.0, 0.0, 2.0), (1.0, 0.2, 2.0))),
}
TURN_S = 7.0
PAUSE_S = 0.6
SEAM_S = 0.5


def made(animator: Animator, speech: np.ndarray, asked: Controls = PLAIN, fps: float = 25.0) -> list[Animation]:
    """Generate animations of embedded speech."""
    return animator.generate_from_embedding(speech, SAMPLES, 0, fps, asked)


def targets(animator: Animator, speech: np.ndarray) -> None:
    """Print the accuracy of gaze at targets, each for two of every five seconds."""
    print("targets: error of each eye's line of sight from 0.8 s on, degrees; vergence, degrees; peak speed")
    print("target     fps   error (mean, 99 %)  vergence (set, measured)  first within 1 deg, s  peak / main sequence")
    for name, place in TARGETS_M.items():
        for fps in (25.0, 120.0):
            track = TargetTrack(tuple(Target(t, t + 2.0, name) for t in np.arange(1.0, 40.0, 5.0)), {name: place})
            rows = [_hits(each, track, name, fps) for each in made(animator, speech, Controls(targets=track), fps)]
            miss, got, asked, arrived, ratio = (np.concatenate([row[key] for row in rows]) for key in range(5))
            print(
                f"{name:9s}  {fps:3.0f}   {miss.mean():6.3f} {np.percentile(miss, 99):6.3f}      {asked.mean():8.2f}"
                f" {got.mean():6.2f}        {np.median(arrived):8.2f}            {np.median(ratio):8.2f} ({len(ratio)})"
            )


def _hits(one: Animation, track: TargetTrack, name: str, fps: float) -> tuple[np.ndarray, ...]:
    motion, times = one.motion, np.arange(len(one.motion)) / fps
    places = track.object_track(name).at(times)
    miss = np.degrees(line_of_sight.gaze_error_rad(motion.head, motion.gaze, places, "world"))
    angles = rotation.gaze_to_angles(motion.gaze) - line_of_sight.MEAN_KAPPA_RAD
    space = line_of_sight.cyclopean_line_of_sight_rad(rotation.gaze_in_space(motion.head, motion.gaze))
    beside = np.degrees(np.hypot(*(space - line_of_sight.point_direction_rad(motion.head, places)).T))
    on = np.any([(times >= each.start_s + 0.8) & (times < each.end_s - 0.05) for each in track.targets], axis=0)
    arrived = [
        float(times[(times > each.start_s) & (beside < 1.0)][0] - each.start_s)
        for each in track.targets
        if ((times > each.start_s) & (times < each.end_s) & (beside < 1.0)).any()
    ]
    seen = (
        places
        + line_of_sight.BETWEEN_EYES_M
        - np.einsum("tij,j->ti", rotation.rotvec_to_matrix(motion.head), line_of_sight.BETWEEN_EYES_M)
    )
    asked = np.degrees(2 * np.arctan(0.03145 / np.linalg.norm(seen, axis=1)))
    speed = gaze_in_space_speed_deg_s(motion.head, motion.gaze, fps)
    ratio = [_peak(each, speed, fps) for each in one.events.saccades if _to_target(each, track)]
    return (
        miss[on].ravel(),
        np.degrees(angles[on, 1, 0] - angles[on, 0, 0]),
        asked[on],
        np.array(arrived),
        np.array(ratio),
    )


def _to_target(each: object, track: TargetTrack) -> bool:
    size = np.hypot(*np.subtract(each.end_rad, each.start_rad))  # type: ignore[attr-defined]
    return size > np.radians(4) and any(each.onset_s == target.start_s for target in track.targets)  # type: ignore[attr-defined]


def _peak(each: object, speed: np.ndarray, fps: float) -> float:
    size = float(np.hypot(*np.subtract(each.end_rad, each.start_rad)))  # type: ignore[attr-defined]
    around = slice(int(each.onset_s * fps), int((each.onset_s + each.duration_s) * fps) + 2)  # type: ignore[attr-defined]
    return float(speed[around].max() / np.degrees(saccades.peak_speed(size)))


def eye_contact(animator: Animator, speech: np.ndarray) -> None:
    print("\neye contact: set, measured (mean, range over samples), saccades per second, mean amplitude in degrees")
    for asked in (None, 0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0):
        animations = made(animator, speech, Controls(eye_contact=asked))
        shares = [_share(each.motion) for each in animations]
        print(
            f"{'model' if asked is None else asked!s:6s} {np.mean(shares):.3f} ({min(shares):.3f} to {max(shares):.3f})"
            f"   {_rate(animations):.2f}   {_size_deg(animations):.2f}"
        )


def _share(motion: Motion) -> float:
    ahead = np.tile([0.0, 0.0, 1.0], (len(motion), 1))
    return eye_contact_fraction(motion.head, rotation.gaze_in_space(motion.head, motion.gaze), ahead)


def _rate(animations: list[Animation]) -> float:
    return float(np.mean([len(each.events.saccades) / each.motion.seconds for each in animations]))


def _size_deg(animations: list[Animation]) -> float:
    steps = [np.subtract(s.end_rad, s.start_rad) for each in animations for s in each.events.saccades]
    return float(np.degrees(np.hypot(*np.array(steps).T)).mean()) if steps else 0.0


def dials(animator: Animator, speech: np.ndarray) -> None:
    print(
        "\nliveliness: factor; head deg/s; saccades: mean degrees, per second; gaze SD (yaw, pitch); blinks per minute"
    )
    for dial in (0.0, 0.5, 1.0, 1.5, 2.0, 3.0):
        animations = made(animator, speech, Controls(liveliness=Liveliness(dial, dial, dial)))
        speed = np.mean([head_speed_deg_s(each.motion.head, 25.0).mean() for each in animations])
        spaces = [rotation.gaze_in_space(each.motion.head, each.motion.gaze) for each in animations]
        yaw, pitch = np.degrees(np.mean([rotation.cyclopean_gaze(space).std(axis=0) for space in spaces], axis=0))
        rate = np.mean([60 * len(each.events.blinks) / each.motion.seconds for each in animations])
        print(
            f"{dial:3.1f}   {speed:5.2f}   {_size_deg(animations):5.2f} {_rate(animations):5.2f}"
            f"   {yaw:5.2f} {pitch:5.2f}   {rate:5.1f}"
        )


def styles(animator: Animator, speech: np.ndarray) -> None:
    """Print the distance of the style of animations from that of each training speaker, by kind of control."""
    asked: dict[str, Callable[[str], Controls]] = {
        "random": lambda name: PLAIN,
        "person": lambda name: Controls(person=name),
        "style": lambda name: Controls(style=name),
    }
    names = list(animator.speaker_styles)
    kept = np.array([_numbers(motion_style) for motion_style in animator.speaker_styles.values()])
    spread = kept.std(axis=0)
    print(f"\nstyles of {len(names)} speakers: mean distance of an animation's style from the speaker's")
    print(
        "               head mean  head SD  gaze mean  gaze SD (degrees)  saccades/min  blinks/min  right one nearest"
    )
    for kind, of in asked.items():
        off, right = [], 0
        for index, name in enumerate(names):
            for each in made(animator, speech, of(name)):
                got = _numbers(measure_style(each.motion))
                off.append(np.abs(got - kept[index]))
                right += int(np.argmin((((kept - got) / spread) ** 2).sum(axis=1)) == index)
        print(f"{kind:13s}  {_line(np.mean(off, axis=0))}   {right} of {SAMPLES * len(names)}")
    print(f"{'SD of speakers':13s} {_line(spread)}   by chance {SAMPLES}")


def _line(numbers: np.ndarray) -> str:
    """Mean absolute difference in degrees for each kind of angle, and for the two rates."""
    degrees = " ".join(f"{numbers[part].mean():6.2f}  " for part in np.split(np.arange(10), (3, 6, 8)))
    return f"{degrees}            {numbers[10]:6.1f}       {numbers[11]:6.1f}"


def _numbers(motion_style: MotionStyle) -> np.ndarray:
    angles = [
        motion_style.head_mean_rad,
        motion_style.head_sd_rad,
        motion_style.gaze_mean_rad,
        motion_style.gaze_sd_rad,
    ]
    return np.concatenate(
        [*np.degrees(np.concatenate(angles))[None], [motion_style.saccades_per_min, motion_style.blinks_per_min]]
    )


def dialogue(animator: Animator, sounds: list[np.ndarray]) -> None:
    one, other = _dealt(sounds)
    heard = detect_turns(one, other)
    print(
        "\ndialogue, and the same sound without partner, all people: eye contact and head speed (deg/s) in own and in"
    )
    print("partner turns; blinks per minute 0.25 to 0.5 s after the partner's phrases end, and else in those turns")
    for name, partner in (("dialogue", other), ("alone", None)):
        asked = [Controls(person=person, partner=partner) for person in animator.speaker_styles]
        animations = [each for ask in asked for each in animator.perform(one, SAMPLES, 0, 25.0, ask)]
        rows = [_by_turn(each, heard) for each in animations]
        own, theirs, own_speed, their_speed, after, else_ = np.mean(rows, axis=0)
        print(f"{name:9s} {own:.3f} {theirs:.3f}   {own_speed:5.2f} {their_speed:5.2f}   {after:5.1f} {else_:5.1f}")


def _dealt(said: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Assign sounds to two people in turn, as one channel each."""
    sounds: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for index, sound in enumerate(said):
        part = np.append(sound, np.zeros(int(PAUSE_S * SAMPLE_RATE)))
        sounds[index % 2].append(part)
        sounds[1 - index % 2].append(np.zeros(len(part)))
    first, second = (np.concatenate(parts).astype(np.float32) for parts in sounds)
    return first, second


def _by_turn(one: Animation, heard: Annotation) -> tuple[float, ...]:
    motion, times = one.motion, np.arange(len(one.motion)) / 25.0
    own, theirs = (_within(times, spans) for spans in (heard.speaking, heard.listening))
    speed = np.append(head_speed_deg_s(motion.head, 25.0), 0.0)
    after = [Span(span.end_s + PARTNER_END_S[0], span.end_s + PARTNER_END_S[1]) for span in heard.partner]
    blinks_s = np.array([blink.onset_s for blink in one.events.blinks])
    answers, listened = (_within(blinks_s, spans) for spans in (after, heard.listening))
    answering_s, listening_s = _within(times, after).sum() / 25.0, (theirs & ~_within(times, after)).sum() / 25.0
    return (
        *(_share(_part(motion, mask)) for mask in (own, theirs)),
        *(float(speed[mask].mean()) for mask in (own, theirs)),
        60.0 * answers.sum() / answering_s,
        60.0 * (listened & ~answers).sum() / listening_s,
    )


def _within(times_s: np.ndarray, spans: Sequence[Span]) -> np.ndarray:
    return np.asarray(np.any([(times_s >= span.start_s) & (times_s < span.end_s) for span in spans], axis=0))


def _part(motion: Motion, mask: np.ndarray) -> Motion:
    names = ("head", "translation", "gaze", "lid", "jaw", "expression", "valid")
    return replace(motion, **{name: getattr(motion, name)[mask] for name in names})


def windows(animator: Animator, speech: np.ndarray) -> None:
    """Print the speed at seams relative to elsewhere, and the same for equally spaced times between seams."""
    sound = np.tile(speech, 5)
    seams_s = [(start + SAMPLE_RATE) / SAMPLE_RATE for start in window_starts(len(sound), 160_000, 32_000)[1:]]
    animations = made(animator, animator.encoder(sound, animator.fps))
    print(
        f"\nwindows: {len(seams_s)} seams in {len(sound) / SAMPLE_RATE:.0f} s; speed within {SEAM_S} s of them over"
        " elsewhere (1: invisible), and the range of this ratio around equally spaced times"
    )
    for name, speed_of in (("head", _head_speed), ("gaze", _gaze_speed), ("head, change of speed", _head_jerk)):
        speed = np.array([speed_of(each.motion) for each in animations])
        times = np.arange(speed.shape[1]) / 25.0
        at = np.any([np.abs(times - seam) <= SEAM_S for seam in seams_s], axis=0)
        shifted = [
            _ratio(speed, np.any([np.abs(times - seam - shift) <= SEAM_S for seam in seams_s], axis=0))
            for shift in np.arange(1.1, 6.9, 0.5)
        ]
        print(f"{name:22s} {_ratio(speed, at):.3f}   {min(shifted):.3f} to {max(shifted):.3f}")


def _ratio(speed: np.ndarray, at: np.ndarray) -> float:
    return float(speed[:, at].mean() / speed[:, ~at].mean())


def _head_speed(motion: Motion) -> np.ndarray:
    return np.asarray(head_speed_deg_s(motion.head, 25.0))


def _gaze_speed(motion: Motion) -> np.ndarray:
    return np.asarray(gaze_in_space_speed_deg_s(motion.head, motion.gaze, 25.0))


def _head_jerk(motion: Motion) -> np.ndarray:
    return np.asarray(np.degrees(np.linalg.norm(np.diff(motion.head, 2, axis=0), axis=1)) * 25.0)


def main() -> None:
    """Print all tables, or only that of a dialogue if sounds are given."""
    model, *sounds = sys.argv[1:] or [str(MODEL)]
    animator = Animator.load(Path(model))
    if sounds:
        dialogue(animator, [read_speech(Path(each)) for each in sounds])
        return
    speech = read_speech(package_file(EXAMPLE_SPEECH))
    embedded = animator.encoder(speech, animator.fps)
    for table in (targets, eye_contact, dials, styles):
        table(animator, embedded)
    dialogue(animator, np.split(speech, range(int(TURN_S * SAMPLE_RATE), len(speech), int(TURN_S * SAMPLE_RATE))))
    windows(animator, speech)


if __name__ == "__main__":
    run_command(main)
