"""What is damaged, and the command that then reads it: a good file of every kind that the command line opens."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import av
import face_files
import flame_file
import numpy as np
import soundfile
import torch
import toy_motions
from command_line import call
from pxr import Usd
from test_gaussian_avatar import on_triangles
from test_study import a_study, crowd
from toy_model import sound_file, toy_model
from toy_people import people_csv

from talkingeyes.animation.conversation_states import SCHEMA as STATE_SCHEMA
from talkingeyes.animation.model_file import PACKAGED_LIVE_MODEL, PACKAGED_MODEL
from talkingeyes.animation.targets import SCHEMA as TARGET_SCHEMA
from talkingeyes.apps.study.design import DESIGNS_FOLDER, load_design
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.store import Corpus, make_shard_path, shard_path
from talkingeyes.formats.writers.gaussians import write_gaussians
from talkingeyes.workflows import convert


@dataclass(frozen=True)
class Target:
    """A file below the folder of good files, its form (`mutations.FORMS`), and a command that reads it and writes
    `out` or a name that starts with it. `words` of a command stand for themselves; `{text}` is the damaged text."""

    name: str
    form: str
    file: str
    words: str


ANIMATE = "--samples 1 --no-previews"
FORM_OF_SUFFIX = {
    **dict.fromkeys(("csv", "tsv", "bvh", "usda", "obj", "yaml", "words"), "text"),
    **dict.fromkeys(("json", "jsonl", "gltf"), "json"),
    **dict.fromkeys(("glb", "vrma", "vrm"), "glb"),
    **dict.fromkeys(("pt", "frame"), "torch"),
    "pkl": "pickle",
    **{name: name for name in ("npz", "npy", "safetensors", "parquet")},
}


def _of(command: str, files: Iterable[str], words: str) -> list[Target]:
    """A target a file; its form follows from its ending."""
    return [
        Target(f"{command} {name}", FORM_OF_SUFFIX.get(name.rpartition(".")[2], "binary"), name, words)
        for name in files
    ]


def _sharded(folder: str, name: str, suffix: str) -> str:
    return str(shard_path(Path(folder), name, suffix))


def targets(cases: Iterable[str] = ()) -> list[Target]:
    """Every kind of file with its command. `cases`: names of files of other programs that lie in the folder, too."""
    imported = [
        *("openface.csv", "pyfeat.csv", "bones.bvh", "scene.usda", "scene.usdc", "mesh.obj", "array.npy", "torch.pt"),
        *("lips.vrma", "face.glb", "tracked.npz", "frames.jsonl", "00001.frame", *cases),
    ]
    found = [
        *_of(
            "animate",
            ("a.wav", "a.flac", "a.ogg", "a.mp3", "a.m4a"),
            f"animate {{file}} -o out --model model {ANIMATE}",
        ),
        *_of("partner", ("b.wav",), f"animate s.wav --partner {{file}} -o out --model model {ANIMATE}"),
        *_of("model", ("toy.safetensors", "events.safetensors"), f"animate s.wav -o out --model {{file}} {ANIMATE}"),
        *_of(
            "model folder",
            (f"model/{name}.json" for name in ("config", "embedding", "blinks", "speakers")),
            f"animate s.wav -o out --model model {ANIMATE}",
        ),
        *_of(
            "target", ("target.json", "target.csv"), f"animate s.wav -o out --model model --target {{file}} {ANIMATE}"
        ),
        *_of(
            "states", ("states.json", "states.csv"), f"animate s.wav -o out --model model --states {{file}} {ANIMATE}"
        ),
        *_of("style", ("style.npz",), f"animate s.wav -o out --model model --style {{file}} {ANIMATE}"),
        *_of("part", ("part.npz",), f"animate s.wav -o out --model model --replace head={{file}} {ANIMATE}"),
        *(
            Target(f"export {format} motion.npz", "npz", "motion.npz", f"export {{file}} -f {format} -o out{suffix}")
            for format, suffix in (("arkit", ".json"), ("bvh", ".bvh"), ("events", ".json"), ("glb", ".glb"))
        ),
        *_of("keys", ("keys.events.json",), "export motion.npz -f bvh -o out.bvh --keys {file}"),
        *_of("flame head", ("flame.pkl",), "export flame.npz -f livelink -o out.csv --model {file}"),
        *_of("lids", ("eyelid.npz",), "export motion.npz -f obj -o out.obj --eyelid {file}"),
        *_of(
            "avatar",
            (f"avatar/{name}" for name in ("point_cloud.ply", "flame_param.npz", "flame.pkl")),
            "export motion.npz -f ply -o out.ply --head gaussians --model avatar",
        ),
        *_of("labels", ("labels.json",), "eyelid fit {file} -o out.npz"),
        *_of("cameras", ("cameras.json",), "capture face.png -o out --cameras {file}"),
        *_of("capture", ("face.png", "face.mp4"), "capture {file} -o out"),
        *_of("track", ("speech.mp4",), "track {file} -o out --dry-run"),
        *_of("speakers", ("speakers.csv",), "track speech.mp4 -o out --dry-run --speakers {file}"),
        *_of("import", imported, "import {file} -o out.npz --fps 25"),
        *_of("map", ("map.yaml",), "import tracked.npz -o out.npz --map {file}"),
        *_of("mapped", ("mapped.npz",), "import {file} -o out.npz --map pose.yaml"),
        *(
            Target(
                f"add-eyes {name}",
                FORM_OF_SUFFIX[name.rpartition(".")[2]],
                f"faces/{name}",
                f"add-eyes {{file}} s.wav -o out.{name.rpartition('.')[2]} --model model"
                + (f" --fps {fps}" if fps else ""),
            )
            for name, _, fps in face_files.LAYOUTS.values()
        ),
        *_of("evaluate", ("motions/c-1.npz",), "evaluate motions --reference corpus -o out --n-resamples 20"),
        *_of(
            "corpus",
            (
                "corpus/clips.parquet",
                f"corpus/{_sharded('truth', 'c-1', '.npz')}",
                f"corpus/{_sharded('annotations', 's-1', '.json')}",
            ),
            "evaluate motions --reference corpus -o out --n-resamples 20",
        ),
        *_of("people", ("people.csv",), "evaluate spoken --sound spoken --people {file} -o out --n-resamples 20"),
        *_of(
            "timing",
            ("contact.csv", "turns.csv"),
            "evaluate talks --sound talks --people contact.csv --turns turns.csv -o out --n-resamples 20",
        ),
        *_of("study", ("study/study.json", "study/answers.sqlite"), "study results study"),
        *_of("design", ("design.yaml",), "study make {file} -o out --corpus corpus --allow-fewer --size 16"),
        *_of("override", ("override.words",), "track speech.mp4 -o out --dry-run --set {text}"),
        *_of("control", ("camera.words",), "render motion.npz -o out.mp4 --size 16 --camera {text}"),
        *_of("parts", ("parts.words",), f"animate s.wav -o out --model model --replace {{text}} {ANIMATE}"),
    ]
    return found


def write_good_files(folder: Path, cases: Iterable[Path] = ()) -> None:
    """Write them all; `cases` are copied."""
    folder.mkdir(parents=True, exist_ok=True)
    for case in cases:
        (folder / case.name).write_bytes(case.read_bytes())
    motion, flame = toy_motions.motion(seconds=1.0), toy_motions.flame_motion().cut(0, 25)
    for name in ("motion", "style", "part"):
        motion.save(folder / f"{name}.npz")
    flame.save(folder / "flame.npz")
    _write_sounds(folder)
    _write_videos(folder)
    _write_controls(folder)
    _write_heads(folder)
    _write_models(folder)
    for name, format in (("bones.bvh", "bvh"), ("scene.usda", "usd"), ("face.glb", "glb"), ("mesh.obj", "obj")):
        convert.write_motion(motion.cut(0, 12), None, format, folder / name)
    Usd.Stage.Open(str(folder / "scene.usda")).Export(str(folder / "scene.usdc"))
    write_faces(folder)
    _write_tables(folder)
    _write_corpus(folder)
    crowd(a_study(folder / "study", load_design("eyelid_follow")), 2, {("following", "static"): 0.8})
    (folder / "design.yaml").write_bytes((DESIGNS_FOLDER / "eyelid_follow.yaml").read_bytes())


def _write_sounds(folder: Path) -> None:
    sound_file(folder / "s.wav", 1.0)
    data, rate = soundfile.read(folder / "s.wav")
    for name in ("a.wav", "b.wav", "a.flac", "a.ogg", "a.mp3"):
        soundfile.write(folder / name, data, rate)
    with av.open(str(folder / "a.m4a"), "w") as file:
        stream = file.add_stream("aac", rate=rate)
        frame = av.AudioFrame.from_ndarray(data[None].astype(np.float32), "fltp", "mono")
        frame.sample_rate = rate
        for packet in (*stream.encode(frame), *stream.encode(None)):
            file.mux(packet)


def _write_videos(folder: Path) -> None:
    """Two frames of the open head, with sound; a picture of it."""
    toy_motions.motion().cut(0, 2).save(folder / "short.npz")
    assert (
        call("render", folder / "short.npz", "-o", folder / "face.mp4", "--size", "256", "--sound", folder / "s.wav")
        == 0
    )
    (folder / "speech.mp4").write_bytes((folder / "face.mp4").read_bytes())
    with av.open(str(folder / "face.mp4")) as film:
        next(film.decode(video=0)).to_image().save(folder / "face.png")


def _write_controls(folder: Path) -> None:
    track = {"start_s": 0.2, "end_s": 0.5, "at": "lamp"}
    target = {
        "frame": "world",
        "objects": {"lamp": {"times_s": [0.0, 0.9], "positions_m": [[0.1, 0.2, 1.0], [0.3, 0.1, 1.5]]}},
        "targets": [track],
    }
    (folder / "target.json").write_text(json.dumps({"schema": TARGET_SCHEMA, **target}))
    (folder / "target.csv").write_text("start_s,end_s,name,x_m,y_m,z_m\n0,0.4,lamp,0.1,0.2,1\n0.5,,camera,,,\n")
    states = [{"start_s": 0.0, "state": "speaking"}, {"start_s": 0.5, "end_s": 0.9, "state": "thinking"}]
    (folder / "states.json").write_text(json.dumps({"schema": STATE_SCHEMA, "states": states}))
    (folder / "states.csv").write_text("start_s,end_s,state\n0,0.4,speaking\n0.5,,thinking\n")
    camera = {
        "focal_px": 200.0,
        "centre_px": [80.0, 60.0],
        "rotation": [0.0, 0.0, 0.0],
        "translation_m": [0.0, 0.0, 1.0],
    }
    (folder / "cameras.json").write_text(json.dumps({"schema": "talkingeyes.cameras/1", "cameras": [camera]}))
    (folder / "override.words").write_text("clip_filter.min_duration_s=2.5")
    (folder / "camera.words").write_text("yaw=30,pitch=10,distance=0.9,height=0.3")
    (folder / "parts.words").write_text("head=part.npz")
    assert call("export", folder / "motion.npz", "-f", "events", "-o", folder / "keys.events.json") == 0


def _write_heads(folder: Path) -> None:
    flame_file.write(folder / "flame.pkl", flame_file.arrays())
    avatar = folder / "avatar"
    avatar.mkdir()
    bound = on_triangles([0, 5000, 9976 + 167])
    write_gaussians(avatar / "point_cloud.ply", bound.local, bound.binding)
    flame_file.write(avatar / "flame.pkl", flame_file.arrays())
    np.savez(
        avatar / "flame_param.npz", shape=np.zeros(2, np.float32), static_offset=np.zeros((1, 5143, 3), np.float32)
    )
    assert call("eyelid", "example", "-o", folder / "labels.json") == 0
    assert call("eyelid", "fit", folder / "labels.json", "-o", folder / "eyelid.npz") == 0


def _write_models(folder: Path) -> None:
    toy_model(folder / "model")
    assert call("pack", folder / "model", "-o", folder / "toy.safetensors") == 0
    (folder / "events.safetensors").write_bytes(PACKAGED_MODEL.read_bytes())
    (folder / "live.safetensors").write_bytes(PACKAGED_LIVE_MODEL.read_bytes())


def write_faces(folder: Path) -> Path:
    """Write files of face motion alone, which are read quickly."""
    (folder / "faces").mkdir()
    for name, write, _ in face_files.LAYOUTS.values():
        write(folder / "faces" / name)
    rng = np.random.default_rng(0)
    face_files.vhap(folder / "tracked.npz", 20)
    np.savez(folder / "mapped.npz", rate=25.0, pose=rng.normal(0, 0.1, (20, 6)), eyes=rng.normal(0, 0.1, (20, 6)))
    (folder / "pose.yaml").write_text(
        "fps: {key: rate}\nhead: {key: pose, columns: [0, 3]}\ngaze: {key: eyes, unit: degrees}\n"
    )
    (folder / "map.yaml").write_text(
        "fps: 25\nhead: {key: rotation, unit: radians}\ngaze: {key: eyes_pose, columns: [0, 6], eyes: left_right}\n"
    )
    np.save(folder / "array.npy", rng.normal(0, 0.05, (20, 53)))
    torch.save(torch.zeros(20, 53), folder / "torch.pt")
    turn = np.eye(3, dtype=np.float32)
    flame = {
        "exp": np.zeros((1, 100), np.float32),
        "eyes": turn[None, :2].repeat(2, 0).reshape(1, 12),
        "jaw": turn[:2].reshape(1, 6),
    }
    torch.save({"flame": flame, "opencv": {"R": turn[None], "t": np.ones((1, 3), np.float32)}}, folder / "00001.frame")
    lines = [
        json.dumps({"timestamp": k / 30, "blendShapes": {"jawOpen": 0.1 * k, "eyeBlinkLeft": 0.0}}) for k in range(5)
    ]
    (folder / "frames.jsonl").write_text("\n".join(lines))
    face_files.lips_vrma(folder / "lips.vrma")
    header = (
        "frame, face_id, timestamp, confidence, success, gaze_angle_x, gaze_angle_y, pose_Rx, pose_Ry, pose_Rz, AU45_r"
    )
    rows = [f"{k}, 0, {k / 30:.3f}, 0.98, 1, 0.1, 0.05, 0.1, 0.0, 0.0, 0.5" for k in range(10)]
    (folder / "openface.csv").write_text("\n".join([header, *rows]))
    header = "frame,FaceScore,Pitch,Roll,Yaw,gaze_pitch,gaze_yaw,AU43"
    (folder / "pyfeat.csv").write_text("\n".join([header, *(f"{k},0.9,0.1,0.2,0.1,0.1,0.2,0.3" for k in range(10))]))
    return folder


def _write_tables(folder: Path) -> None:
    (folder / "speakers.csv").write_text("video,speaker\nspeech.mp4,anna\n")
    people_csv(folder / "people.csv", 3)
    (folder / "contact.csv").write_text(
        "pair,person,coder,start_ms,end_ms\np,a,1,0,2000\np,a,1,3000,8000\np,b,1,0,9000\np,a,2,0,2600\np,b,2,1000,9000\n"
        "q,a,1,500,4000\nq,b,1,0,6000\nq,a,2,500,4000\nq,b,2,0,6000\n"
    )
    (folder / "turns.csv").write_text("pair,start_s,end_s,speaker\np,0,4,a\np,4,5,a\np,5,9,b\nq,0,3,b\nq,3,7,a\n")
    for name in ("spoken", "talks"):
        (folder / name).mkdir()
    toy_motions.motion(seconds=12.0).save(folder / "spoken" / "a.npz")
    sound_file(folder / "spoken" / "a.wav", 12.0)
    sound, rate = soundfile.read(folder / "spoken" / "a.wav")
    own = np.arange(len(sound)) < 6 * rate  # who speaks first; then the partner
    for name in ("a", "b"):  # intervals are over two persons or more
        toy_motions.motion(seconds=12.0).save(folder / "talks" / f"{name}.npz")
        soundfile.write(folder / "talks" / f"{name}.wav", np.stack([sound * own, sound * ~own], axis=1), rate)


def _write_corpus(folder: Path) -> None:
    corpus, motion = Corpus(folder / "corpus"), toy_motions.motion(seconds=2.0)
    (folder / "motions").mkdir()
    clips = [
        Clip(f"c-{k}", f"s-{k}", 0, "anna", "test", 2.0, 25.0, "neutral", 0, "en", "", "", "", "") for k in range(2)
    ]
    for clip in clips:
        corpus.write_sound(
            clip.sound, soundfile.read(folder / "s.wav")[0].repeat(2), Annotation(speaking=(Span(0.1, 1.5),))
        )
        motion.save(make_shard_path(corpus.root / "truth", clip.id, ".npz"))
        toy_motions.events().save(make_shard_path(corpus.root / "truth", clip.id, ".events.json"))
        motion.save(folder / "motions" / f"{clip.id}.npz")
    corpus.write_index(clips)
