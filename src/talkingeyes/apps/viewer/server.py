"""The viewer's page as a web application: all served content is created at the start and kept in memory.

Requests neither read nor write files, so a name from a client cannot lead to any.
"""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING

from talkingeyes.apps.viewer.assets import ASSETS_FOLDER, NAMES, Asset, read_assets
from talkingeyes.apps.viewer.local_server import LOCALHOST, create_app, serve_files
from talkingeyes.apps.viewer.pose_encoding import head_glb, pose_rows
from talkingeyes.apps.viewer.scene import Scene, scene_json
from talkingeyes.audio.waveform import SAMPLE_RATE
from talkingeyes.head.model import HeadModel

if TYPE_CHECKING:
    from fastapi import FastAPI


def viewer_app(scene: Scene, head: HeadModel, host: str = LOCALHOST) -> FastAPI:
    """The application that shows a scene on a head."""
    app = create_app(host)
    serve_files(app, page_files(scene, head))
    return app


def page_files(scene: Scene, head: HeadModel) -> dict[str, Asset]:
    """All files by the name that the page requests."""
    files = read_assets(ASSETS_FOLDER, NAMES)
    files["head.glb"] = Asset(head_glb(head), "model/gltf-binary")
    files["scene.json"] = Asset(json.dumps(scene_json(scene)).encode(), "application/json")
    for index, viewer_motion in enumerate(scene.viewer_motions):
        files[f"poses/{index}"] = Asset(pose_rows(head, viewer_motion.motion).tobytes(), "application/octet-stream")
    if scene.sound is not None:
        import soundfile

        buffer = io.BytesIO()
        soundfile.write(buffer, scene.sound, SAMPLE_RATE, format="WAV", subtype="PCM_16")
        files["sound.wav"] = Asset(buffer.getvalue(), "audio/wav")
    return files
