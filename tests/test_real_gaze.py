"""The detectors on recordings of people, compared with experts. Skipped without the recordings."""

import numpy as np
import pytest

from talkingeyes.corpus.gaze_datasets import SACCADE, read_andersson, read_conversation, read_openface
from talkingeyes.evaluation.detectors.fixations import detect_fixations
from talkingeyes.evaluation.detectors.saccades import detect_saccades
from talkingeyes.evaluation.detectors.scoring import DetectionCounts, cohen_kappa, count_matches, event_mask
from talkingeyes.evaluation.detectors.signal import runs


@pytest.fixture(scope="module")
def folder(request):
    path = request.config.rootpath.parent / "shared/data/real/gaze"
    if not path.is_dir():
        pytest.skip("no real recordings here")
    return path


@pytest.fixture(scope="module")
def labelled(folder):
    return {path.stem: read_andersson(path) for path in sorted(folder.glob("andersson_*.mat"))}


def agreement(labelled, expert, stride):
    total = DetectionCounts()
    for name, each in labelled.items():
        if name.endswith(expert):
            sampled = each.recording.subsample(stride)
            found = detect_saccades(sampled.gaze_in_space_rad, sampled.fps, sampled.valid)
            known = runs(each.labels == SACCADE).first / each.recording.fps
            total += count_matches(found.onset_s, known, 0.05)
    return total.score


# Scores when the detectors were written, less a tolerance of 0.03.
@pytest.mark.parametrize(("stride", "least"), [(1, 0.89), (4, 0.87), (8, 0.87), (20, 0.87)])
def test_saccades_agree_with_an_expert(labelled, stride, least):
    agreed = agreement(labelled, "MN", stride)
    assert agreed.f1 >= least and agreed.known > 100 and abs(agreed.onset_error_s) < 0.01


def test_samples_agree_with_experts_nearly_as_experts_agree(labelled):
    films = {name.rsplit("_", 1)[0] for name in labelled if name.endswith("RA")}
    ours, theirs = [], []
    for name in films:
        one, other = labelled[f"{name}_MN"], labelled[f"{name}_RA"]
        frames = min(len(one.labels), len(other.labels))
        recording = one.recording
        found = detect_saccades(recording.gaze_in_space_rad, recording.fps, recording.valid)
        flags = event_mask(found.onset_s, found.offset_s, recording.fps, frames)
        ours.append(cohen_kappa(flags, one.labels[:frames] == SACCADE))
        theirs.append(cohen_kappa(other.labels[:frames] == SACCADE, one.labels[:frames] == SACCADE))
    assert np.mean(ours) > 0.83 and np.mean(ours) > np.mean(theirs) - 0.08


def test_heads_and_gaze_of_openface_turn_the_same_way(folder):
    for path in sorted(folder.glob("openface_*.csv.gz")):
        recording = read_openface(path)
        yaw = np.corrcoef(recording.head[:, 1], recording.gaze_in_space_rad[:, 0])[0, 1]
        pitch = np.corrcoef(-recording.head[:, 0], recording.gaze_in_space_rad[:, 1])[0, 1]
        assert yaw > 0.4 and pitch > 0.3
        found = detect_saccades(recording.gaze_in_space_rad, recording.fps, recording.valid)
        assert 0.5 < len(found) / (len(recording.valid) / recording.fps) < 4.0
        assert len(detect_fixations(recording.gaze_in_space_rad, recording.fps, recording.valid, found)) > 10


def test_people_look_around_more_when_they_speak(folder):
    read = read_conversation(folder / "conversation_fixations.csv.gz")
    people = sorted(set(read.person))
    spread = {
        state: np.degrees([read.of(person, state).centre_rad[:, 0].std() for person in people])
        for state in ("SPEAK", "LISTEN")
    }
    speak, listen = spread["SPEAK"], spread["LISTEN"]
    assert len(people) == 12 and (speak > listen).sum() >= 11
    assert 7.0 < np.median(speak) < 12.0 and 1.0 < np.median(listen) < 4.0
