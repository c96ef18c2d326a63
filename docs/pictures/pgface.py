"""Draws docs/pictures/pgface.png: one speech under three pitches of the head (Zhang et al., Fig. 7), faces aligned.

Run: python docs/pictures/pgface.py build/posegan/data [OUT.png]
Prints how far the lower face moves by PGFace, and how far it hangs by the law that the data were made with.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from matplotlib import pyplot as plt

from talkingeyes.corpus.poses import head_rotations
from talkingeyes.corpus.store import Corpus
from talkingeyes.head.anny import anny_head
from talkingeyes.head.normals import incidence_matrix, normals_from_incidence
from talkingeyes.head.sag import FaceSurface
from talkingeyes.rendering.render import HeadRenderer
from talkingeyes.rendering.view import FRAMINGS
from talkingeyes.training.checkpoint import load
from talkingeyes.training.pgface_task import PGFaceTaskSettings, pgface_network, read_shape_recording
from talkingeyes.training.pose_windows import cut_windows

PITCHES_DEG = (-18.0, 0.0, 18.0)
SIZE, LEAST_OPEN = 420, 0.9


def main() -> None:
    """One frame with the mouth open, three pitches."""
    data, out = Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else "docs/pictures/pgface.png")
    checkpoint = load(data / "train" / "pgface")
    settings = PGFaceTaskSettings.model_validate(checkpoint.config["model"])
    network, surface = pgface_network(checkpoint), FaceSurface(anny_head())
    clip = Corpus(data / "synthesize").select("test", take=0)[0]
    recording = read_shape_recording(data / "fit", data / "embed", clip, settings.poses)
    output_frame = settings.network.output_frame - 1
    opening = recording.motion.jaw[: len(recording) - settings.network.window, 0]
    start = int(np.argmax(opening >= np.quantile(opening, LEAST_OPEN))) - output_frame
    speech, pose = cut_windows([recording], [(0, max(start, 0))], settings.network.window)
    shapes, lawful = [], []
    for pitch_deg in PITCHES_DEG:
        held = pose.clone()
        held[..., 0] += np.radians(pitch_deg)
        with torch.no_grad():
            shapes.append(network.shapes(network(speech, held))[0].numpy())
        head = head_rotations(held[0, output_frame : output_frame + 1].numpy().astype(np.float64))
        frame = max(start, 0) + output_frame
        lawful.append(surface.shapes(surface.factors(recording.motion.cut(frame, frame + 1), head))[0])
    draw(surface, shapes, out)
    for pitch_deg, made, true in zip(PITCHES_DEG, shapes, lawful, strict=True):
        moved, hangs = ((each - base)[surface.lower] * 1000 for each, base in ((made, shapes[1]), (true, lawful[1])))
        along = (moved * hangs).sum() / max((hangs**2).sum(), 1e-12)
        print(
            f"pitch {pitch_deg:+.0f}: lower face moves {np.linalg.norm(moved, axis=1).mean():.2f} mm, "
            f"hangs {np.linalg.norm(hangs, axis=1).mean():.2f} mm by the law, {along:.2f} of it learnt"
        )


def draw(surface: FaceSurface, shapes: list[np.ndarray], out: Path) -> None:
    """The faces, and under them how far each vertex is from the face at pitch 0."""
    model = surface.model
    renderer = HeadRenderer(model, FRAMINGS["face"].centred_on(model.eye_centres).view(SIZE, SIZE))
    around = incidence_matrix(model.faces, len(model.template))
    figure, axes = plt.subplots(2, 3, figsize=(9, 6.4), layout="constrained")
    for column, (pitch_deg, shape) in enumerate(zip(PITCHES_DEG, shapes, strict=True)):
        vertices = model.template.astype(np.float32).copy()
        vertices[surface.vertices] = shape
        normals = normals_from_incidence(vertices[None], model.faces, around)
        brows = model.vertices_of("brow")
        if len(brows):
            normals[:, brows] = model.brows.of(normals)
        axes[0, column].imshow(renderer.render_frame(vertices, normals[0].astype(np.float32)))
        axes[0, column].set_title(f"pitch {pitch_deg:+.0f}°")
        apart = np.linalg.norm(shape - shapes[1], axis=1) * 1000
        points = axes[1, column].scatter(*shape[:, :2].T, c=apart, s=4, vmin=0, vmax=1.5, cmap="viridis")
        axes[1, column].set_aspect("equal")
        for row in (0, 1):
            axes[row, column].axis("off")
    figure.colorbar(points, ax=axes[1], label="mm from the face at pitch 0")
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    main()
