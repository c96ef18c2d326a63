"""Readers of published gaze recordings of real people, converted to this project's axes and units.

`read_andersson`: 500 Hz eye tracking of people who look at pictures and films with the head on a chin rest, labelled
sample by sample by experts (Andersson et al. 2017, ETdata .mat). `read_openface`: gaze and head pose per frame from
video of faces (OpenFace 2, Baltrusaitis et al. 2018, CSV). `read_conversation`: fixations on the screen in remote
conversation, with segments of speaking and listening (Dembinsky et al. 2024, CSV).

The project does not include the data; the readers take a path. Gaze is (yaw to the subject's left, pitch up) in space.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.io import loadmat
from scipy.ndimage import binary_dilation
from scipy.spatial.transform import Rotation

from talkingeyes.core.containers import read_csv, reading
from talkingeyes.core.errors import InputError

FIXATION, SACCADE, OSCILLATION, PURSUIT, BLINK, UNDEFINED = range(1, 7)  # labels of Andersson et al.
BLINK_MARGIN_S = 0.05  # lids cover part of the pupil before and after the tracker loses it
MIN_CONFIDENCE = 0.8  # of OpenFace, for a frame to be valid
MAX_RECORDING_S = 86_400.0  # what a table of times holds beyond is no recording
MAX_FIXATION_S, MAX_PX = 600.0, 1e5
MAX_SHIFT_S = 0.2  # longest gap between successive fixations; longer gaps may hide other events
# The screen of the conversations: 2250 pixels on 63.735 cm, at a distance of 67.5 cm.
CONVERSATION_CM_PER_PX, CONVERSATION_CM, CONVERSATION_RATE_HZ = 63.735 / 2250, 67.5, 90.0


@dataclass(frozen=True)
class GazeRecording:
    """T frames of a person: gaze in space, head rotation vectors, validity of frames."""

    fps: float
    gaze_in_space_rad: Float[ndarray, "T 2"]
    head: Float[ndarray, "T 3"]
    valid: Bool[ndarray, " T"]

    def subsample(self, frames: int) -> GazeRecording:
        """Point-sample one of every `frames` frames."""
        arrays = (self.gaze_in_space_rad, self.head, self.valid)
        return GazeRecording(self.fps / frames, *(array[::frames] for array in arrays))


@dataclass(frozen=True)
class LabelledRecording:
    """A recording with an expert label for every frame."""

    recording: GazeRecording
    labels: Int[ndarray, " T"]


@dataclass(frozen=True)
class ConversationFixations:
    """N fixations on a screen, in order for each person; angles relative to the median fixation."""

    person: tuple[str, ...]
    state: tuple[str, ...]  # SPEAK, LISTEN, DIALOGUE
    onset_s: Float[ndarray, " N"]
    duration_s: Float[ndarray, " N"]
    centre_rad: Float[ndarray, "N 2"]

    def of(self, person: str, state: str) -> ConversationFixations:
        """The fixations of one person in one state."""
        index = [i for i, each in enumerate(zip(self.person, self.state, strict=True)) if each == (person, state)]
        arrays = (self.onset_s[index], self.duration_s[index], self.centre_rad[index])
        return ConversationFixations((person,) * len(index), (state,) * len(index), *arrays)

    @property
    def gaze_shifts_deg(self) -> Float[ndarray, "K 2"]:
        """Shifts from each fixation to the next, without those across longer gaps."""
        pause = self.onset_s[1:] - self.onset_s[:-1] - self.duration_s[:-1]
        steps = np.degrees(np.diff(self.centre_rad, axis=0))
        return np.asarray(steps[(pause >= 0) & (pause < MAX_SHIFT_S)])


def read_andersson(path: Path) -> LabelledRecording:
    """Read one labelled .mat. Angles follow from the screen's size, resolution and distance in the file."""
    with reading(path, "recording of Andersson et al."):
        data = loadmat(path)["ETdata"][0, 0]
        samples = np.asarray(data["pos"], np.float64)
        size_m, pixels = (np.asarray(data[name], np.float64).ravel() for name in ("screenDim", "screenRes"))
        distance_m, fps = (float(np.squeeze(data[name])) for name in ("viewDist", "sampFreq"))
    at_px = samples[:, 3:5]
    lost = (at_px == 0).all(axis=1) | ~np.isfinite(at_px).all(axis=1)
    on_screen_m = (np.where(lost[:, None], pixels / 2, at_px) - pixels / 2) / pixels * size_m
    # The viewer's right is right on the screen, and rows count downwards.
    gaze = _angles_rad(-on_screen_m[:, 0], -on_screen_m[:, 1], distance_m)
    labels = samples[:, 5].astype(np.int64)
    unseen = binary_dilation(lost | (labels == BLINK), iterations=round(BLINK_MARGIN_S * fps))
    return LabelledRecording(GazeRecording(fps, gaze, np.zeros((len(gaze), 3)), ~unseen), labels)


def read_openface(path: Path) -> GazeRecording:
    """Read an OpenFace table. Its camera looks along +z with y down; its gaze angles are in space."""
    table = _table(path)
    time_s = _column(table, path, "timestamp")
    if len(time_s) < 2 or not (np.diff(time_s) > 0).all():
        raise InputError(f"{path}: should hold two or more frames of one face in order of time, got {len(time_s)}")
    turns = np.stack([_column(table, path, f"pose_R{axis}") for axis in "xyz"], axis=1)
    with reading(path, "OpenFace table"):
        head = Rotation.from_euler("XYZ", turns)
    yaw, down = (_column(table, path, f"gaze_angle_{axis}") for axis in "xy")
    sure = (_column(table, path, "confidence") >= MIN_CONFIDENCE) & (_column(table, path, "success") > 0)
    return GazeRecording(
        fps=float((len(time_s) - 1) / (time_s[-1] - time_s[0])),
        gaze_in_space_rad=np.stack([yaw, -down], axis=1),
        head=head.as_rotvec() * [1.0, -1.0, -1.0],
        valid=np.asarray(sure),
    )


def read_conversation(path: Path) -> ConversationFixations:
    """Read the table of fixations in conversation."""
    table = _table(path)
    for name in ("participant", "state"):
        _check_column(table, path, name)
    x_px, y_px = (_column(table, path, f"center_{axis}_px") for axis in "xy")
    onset_s = _column(table, path, "start_sample") / CONVERSATION_RATE_HZ
    duration_s = _column(table, path, "duration_ms") / 1000
    possible = (onset_s >= 0) & (onset_s < MAX_RECORDING_S) & (duration_s > 0) & (duration_s < MAX_FIXATION_S)
    possible &= np.maximum(np.abs(x_px), np.abs(y_px)) < MAX_PX
    if not possible.all():
        row = int(np.argmin(possible))
        raise InputError(
            f"{path}: row {row + 2}: a fixation should be on a screen, begin within a day and last at most"
            f" {MAX_FIXATION_S:g} s, got {x_px[row]:g}, {y_px[row]:g} px, {onset_s[row]:g} s, {duration_s[row]:g} s"
        )
    right_cm, down_cm = x_px * CONVERSATION_CM_PER_PX, y_px * CONVERSATION_CM_PER_PX
    return ConversationFixations(
        person=tuple(str(each) for each in table["participant"].to_pylist()),
        state=tuple(str(each) for each in table["state"].to_pylist()),
        onset_s=onset_s,
        duration_s=duration_s,
        centre_rad=_angles_rad(-(right_cm - np.median(right_cm)), -(down_cm - np.median(down_cm)), CONVERSATION_CM),
    )


def _angles_rad(left: Float[ndarray, " T"], up: Float[ndarray, " T"], distance: float) -> Float[ndarray, "T 2"]:
    """(yaw, pitch) of points on a plane in front of the viewer, with left and up positive."""
    return np.stack([np.arctan2(left, distance), np.arctan2(up, np.hypot(left, distance))], axis=1)


def _table(path: Path) -> pa.Table:
    table = read_csv(path)
    return table.rename_columns([name.strip() for name in table.column_names])  # OpenFace puts spaces before names


def _check_column(table: pa.Table, path: Path, name: str) -> None:
    if table.column_names.count(name) != 1:
        raise InputError(f"{path}: should have a column {name}, got {', '.join(table.column_names[:6])}, ...")


def _column(table: pa.Table, path: Path, name: str) -> Float[ndarray, " T"]:
    _check_column(table, path, name)
    with reading(path, f"table whose column {name} holds numbers"):
        return np.asarray(table[name].to_numpy(), np.float64)
