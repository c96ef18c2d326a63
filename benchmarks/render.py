"""Rendering speed of the open head, by step, and of its Gaussian avatar. CPU seconds of one process on one core.

Run: python -m benchmarks.render [FRAMES] [FOLDER of an avatar, otherwise made in a minute]
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from talkingeyes.core.motion import Motion
from talkingeyes.core.rotation import angles_to_gaze
from talkingeyes.head.anny import anny_head
from talkingeyes.head.anny_build import build_anny_head
from talkingeyes.head.gaussian_avatar import load_avatar
from talkingeyes.head.looks import dressed_head
from talkingeyes.head.normals import vertex_normals
from talkingeyes.head.posing import motion_to_pose
from talkingeyes.head.skinning import posed_vertices
from talkingeyes.rendering.open_avatar import build_avatar
from talkingeyes.rendering.render import HeadRenderer, RayCaster
from talkingeyes.rendering.splatting import AvatarRenderer
from talkingeyes.rendering.view import FRAMINGS


def test_motion(frames: int) -> Motion:
    """Motion of eyes, lids, jaw and head."""
    times = np.arange(frames)[:, None] / 25.0
    angles = np.radians(np.concatenate([20 * np.sin(2 * times), 12 * np.sin(3 * times)], axis=1))
    gaze = np.repeat(angles_to_gaze(angles)[:, None], 2, axis=1)
    head = np.radians(10 * np.sin(times * [1.0, 1.5, 0.7]))
    jaw = 0.1 * np.abs(np.sin(times * [15.0, 0.0, 0.0]))
    return Motion.of(25.0, head, gaze, jaw=jaw, lid=np.repeat(np.clip(np.sin(5 * times) * 3 - 2, 0, 1), 2, axis=1))


def cpu_ms(call: Callable[[], object], times: int) -> float:
    """Median CPU milliseconds over calls."""
    taken = []
    for _ in range(times):
        start = time.process_time()
        call()
        taken.append(1000 * (time.process_time() - start))
    return float(np.median(taken))


def main() -> None:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 24
    print(f"build of the head: {cpu_ms(build_anny_head, 1):.0f} ms")
    head, motion = dressed_head(), test_motion(frames)
    avatar = load_avatar(Path(sys.argv[2])) if len(sys.argv) > 2 else build_avatar(anny_head())
    splats = AvatarRenderer(avatar, FRAMINGS["head"].view(512, 512))
    film = cpu_ms(lambda: list(splats.draw(motion)), 3) / frames
    print(
        f"{len(avatar.bound.local):,} Gaussians, 512 x 512: {1000 / film:.1f} frames a second ({film:.0f} ms a frame)"
    )
    pose = motion_to_pose(head, motion)
    print(f"poses and skinning: {cpu_ms(lambda: posed_vertices(head, pose), 3) / frames:.1f} ms a frame")
    vertices = posed_vertices(head, pose)
    print(f"normals: {cpu_ms(lambda: vertex_normals(vertices, head.faces), 3) / frames:.1f} ms a frame")
    normals = vertex_normals(vertices, head.faces).astype(np.float32)
    for size in (256, 512):
        renderer = HeadRenderer(head, FRAMINGS["head"].view(size, size))
        next(renderer.draw(motion))
        film = cpu_ms(lambda renderer=renderer: list(renderer.draw(motion)), 3) / frames  # type: ignore[misc]
        places = renderer.view.project(vertices[0])
        caster = RayCaster.of(renderer, vertices[0], normals[0], places)
        rays = renderer.view.rays(np.argwhere(np.ones((size, size)))[:, ::-1] + 0.5).astype(np.float32)
        posed = (renderer, vertices[0], normals[0], places)
        scene = cpu_ms(lambda posed=posed: RayCaster.of(*posed), 9)  # type: ignore[misc]
        starts = np.tile(caster.origin, (len(rays), 1))
        run = cpu_ms(lambda scene=caster.scene, o=starts, rays=rays: scene.run(o, rays), 9)  # type: ignore[misc]
        trace = cpu_ms(lambda caster=caster, rays=rays: caster.trace(rays), 9)  # type: ignore[misc]
        print(f"{size} x {size}: {1000 / film:.1f} frames a second ({film:.0f} ms a frame), of it")
        print(f"  scene and vertices {scene:.0f} ms, {len(rays)} rays {run:.0f} ms, their light {trace - run:.0f} ms")


if __name__ == "__main__":
    main()
