"""The face of streams: a causal face model (`models/face/causal.py`) with the speech features that it needs.

It is in the folder `face_live` beside that of head and gaze, in the same packed file, or else the packaged one
(`model_file.face_source`). What `animation/face.py` does to a face is done here to the frames of a stream.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from talkingeyes.audio.encoder import EmbedSettings
from talkingeyes.core.containers import read_json, reading
from talkingeyes.core.errors import InputError
from talkingeyes.core.settings import validate_section
from talkingeyes.head.anny import anny_head
from talkingeyes.head.posing import expression_shape_names
from talkingeyes.models.face.basis import FaceBasis
from talkingeyes.models.face_stream import FaceStreams
from talkingeyes.training.face_generators import NetworkFaceGenerator, load_face_generator


@dataclass(frozen=True)
class LiveFace:
    """A face model for streams."""

    generator: NetworkFaceGenerator
    embedding: EmbedSettings
    fps: float

    @classmethod
    def load(cls, folder: Path) -> LiveFace:
        """Load a folder of the train stage. Raises InputError if it is no such model of the open head's face."""
        head = anny_head()
        with reading(folder, "trained model"):
            generator = load_face_generator(folder, FaceBasis(head.name, expression_shape_names(head)))
            content = read_json(folder / "embedding.json", "JSON file")
            settings, fps = validate_section("embed", EmbedSettings, content["settings"]), float(content["fps"])
        if not isinstance(generator, NetworkFaceGenerator):
            raise InputError(f"{folder}: should be a face model for streams, such as face_live, got a baseline")
        found = cls(generator, settings, fps)
        found.streams.begin()
        return found

    @cached_property
    def streams(self) -> FaceStreams:
        """The network for streams; its weights are there once for all."""
        return FaceStreams(self.generator.network)

    @property
    def lookahead_frames(self) -> int:
        """Number of future frames of the embedding that a frame needs."""
        return self.generator.network.speech.stack.lookahead or 0
