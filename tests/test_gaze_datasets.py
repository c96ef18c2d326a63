"""Readers of published gaze recordings: axes, units, signs, missing data; one-line errors."""

import gzip

import numpy as np
import pytest
from scipy.io import savemat

from talkingeyes.core import rotation
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.gaze_datasets import (
    SACCADE,
    ConversationFixations,
    read_andersson,
    read_conversation,
    read_openface,
)


def write_andersson(path, at_px, labels, **others):
    samples = np.column_stack([np.zeros((len(labels), 3)), at_px, labels])
    fields = {"pos": samples, "screenDim": [0.38, 0.30], "screenRes": [1024, 768], "viewDist": 0.67, "sampFreq": 500}
    savemat(path, {"ETdata": {**fields, **others}})
    return path


def test_andersson(tmp_path):
    at_px = np.full((600, 2), [512.0, 384.0])
    at_px[100:200] = [1024.0, 384.0]  # the right edge of the screen
    at_px[200:300] = [512.0, 0.0]  # the top
    at_px[400:410] = 0.0  # lost
    labels = np.ones(600)
    labels[95:100] = SACCADE
    read = read_andersson(write_andersson(tmp_path / "one.mat", at_px, labels))
    recording = read.recording
    assert recording.fps == 500.0 and not recording.head.any()
    assert np.allclose(recording.gaze_in_space_rad[0], 0.0)
    assert np.degrees(recording.gaze_in_space_rad[150]) == pytest.approx([-np.degrees(np.arctan(0.19 / 0.67)), 0.0])
    assert np.degrees(recording.gaze_in_space_rad[250]) == pytest.approx([0.0, np.degrees(np.arctan(0.15 / 0.67))])
    assert np.flatnonzero(~recording.valid).tolist() == list(range(375, 435))
    assert (read.labels == SACCADE).sum() == 5
    slow = recording.subsample(20)
    assert slow.fps == 25.0 and len(slow.valid) == 30
    assert np.array_equal(slow.gaze_in_space_rad[5], recording.gaze_in_space_rad[100])


OPENFACE = ["timestamp", "confidence", "success", "gaze_angle_x", "gaze_angle_y", "pose_Rx", "pose_Ry", "pose_Rz"]


def write_csv(path, columns, rows):
    text = "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)])
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


def test_openface(tmp_path):
    rows = [[t / 30, 0.98, 1, 0.1, 0.2, 0.0, -0.3, 0.0] for t in range(40)]
    rows[3][1], rows[4][2] = 0.5, 0
    rows[5][5:] = [0.2, 0.0, 0.0]
    recording = read_openface(write_csv(tmp_path / "face.csv.gz", OPENFACE, rows))
    assert recording.fps == pytest.approx(30.0)
    assert np.allclose(recording.gaze_in_space_rad, [0.1, -0.2])
    assert np.allclose(recording.head[0], [0.0, 0.3, 0.0]) and np.allclose(recording.head[5], [0.2, 0.0, 0.0])
    yaw, pitch = rotation.gaze_to_angles(recording.head[[0, 5]]).T
    assert yaw[0] > 0 and pitch[1] < 0  # to the subject's left; down
    assert np.flatnonzero(~recording.valid).tolist() == [3, 4]


CONVERSATION = ["participant", "state", "start_sample", "duration_ms", "center_x_px", "center_y_px"]


def test_conversation(tmp_path):
    rows = [
        ["00", "SPEAK", 0, 1000, 1000, 500],
        ["00", "SPEAK", 93, 1000, 1200, 500],
        ["00", "SPEAK", 300, 2000, 1000, 300],
        ["01", "LISTEN", 0, 100, 1000, 500],
    ]
    read = read_conversation(write_csv(tmp_path / "fixations.csv", CONVERSATION, rows))
    one = read.of("0", "SPEAK")
    assert len(one.onset_s) == 3 and one.duration_s.tolist() == [1.0, 1.0, 2.0] and one.person == ("0",) * 3
    # The second fixation follows at once, 200 px (5.7 cm) to the right; the third after a second.
    assert one.gaze_shifts_deg.shape == (1, 2)
    assert one.gaze_shifts_deg[0] == pytest.approx([-np.degrees(np.arctan(200 * 63.735 / 2250 / 67.5)), 0.0], abs=0.01)
    assert np.degrees(one.centre_rad[2, 1] - one.centre_rad[0, 1]) > 4.0
    assert isinstance(read.of("9", "SPEAK"), ConversationFixations) and not len(read.of("9", "SPEAK").onset_s)


def test_bad_files_are_one_line_errors(tmp_path):
    text = tmp_path / "text.mat"
    text.write_text("no matrix")
    other = tmp_path / "other.mat"
    savemat(other, {"something": 1})
    table = write_csv(tmp_path / "table.csv", ["timestamp", "x"], [[0.0, 1.0], [1.0, 1.0]])
    words = write_csv(tmp_path / "words.csv", OPENFACE, [["a", *range(7)], ["b", *range(7)]])
    once = write_csv(tmp_path / "once.csv", OPENFACE, [range(8)])
    twice = write_csv(tmp_path / "twice.csv", OPENFACE, [range(8), range(8)])
    for read, path, says in [
        (read_openface, once, "two or more frames of one face in order of time, got 1"),
        (read_openface, twice, "two or more frames of one face in order of time, got 2"),
        (read_andersson, text, "not a readable recording of Andersson"),
        (read_andersson, other, "not a readable recording of Andersson"),
        (read_andersson, tmp_path / "none.mat", "not a readable recording of Andersson"),
        (read_openface, tmp_path / "none.csv", "not a readable CSV table"),
        (read_openface, table, "should have a column pose_Rx, got timestamp, x"),
        (read_openface, words, "not a readable table whose column timestamp holds numbers"),
        (read_conversation, table, "should have a column participant"),
    ]:
        with pytest.raises(InputError, match=says) as error:
            read(path)
        assert "\n" not in str(error.value) and str(path) in str(error.value)
