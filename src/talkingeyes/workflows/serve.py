"""`talkingeyes serve`: the service with its models.

Loads one trained model for files and one for live streams, and serves until interrupted. Uploads and results are stored
in a temporary folder, which is removed at the end. `file_workers` creates the workers for files, `stream_worker` those
for streams.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import soundfile

from talkingeyes.animation.line_of_sight import to_forward_axes
from talkingeyes.animation.model_file import PACKAGED_LIVE_MODEL, find_model
from talkingeyes.apps.service.animation_request import AnimationRequest, EyesRequest, Limits
from talkingeyes.apps.viewer.local_server import LOCALHOST, serve
from talkingeyes.audio.waveform import SAMPLE_RATE, read_speech
from talkingeyes.core.atomic_file import temporary_folder
from talkingeyes.core.errors import InputError
from talkingeyes.workflows import convert

LIVE_MODEL_NAME = "talkingeyes_live"
PORT = 8030
LIMITS = Limits(
    streams=200,
    max_stream_s=900.0,
    files=1,
    max_speech_s=60.0,
    max_upload_bytes=32 << 20,
    work_timeout_s=120.0,
    idle_timeout_s=10.0,
    max_results=40,
)


def run_service(
    *,
    model: Path | str | None = None,
    live: Path | str | None = None,
    eyelid: Path | str | None = None,
    look: str | None = None,
    host: str = LOCALHOST,
    port: int = PORT,
    limits: Limits = LIMITS,
    jobs: int = 2,
    stream_origins: Sequence[str] = (),
    on_start: Callable[[str], None],
) -> None:
    """Serve until interrupted; `on_start` is called with the URL.

    `live` is the model for streams; by default the one beside `model`, else the packaged one. `eyelid`: the lids of a
    person (`talkingeyes eyelid fit`) for the head of the page and of exported files; `look`: that of this head. `jobs`
    is the number of processes for streams. Pages of `stream_origins` may open streams. Raises InputError (one line) for
    an invalid model, port or origin.
    """
    from talkingeyes.animation.animator import Animator
    from talkingeyes.animation.streaming import LiveModel
    from talkingeyes.apps.service.app import ServiceResources, service_app
    from talkingeyes.apps.service.worker_pool import WorkerPool
    from talkingeyes.apps.viewer.pose_encoding import head_glb
    from talkingeyes.head.looks import DEFAULT_LOOK
    from talkingeyes.models.face.style import EMOTIONS
    from talkingeyes.workflows.render import load_shown_head

    for_files = find_model(model)
    streamed = find_live_model(for_files, live)
    animator = Animator.load(for_files)
    LiveModel.load(streamed)
    shown = look or DEFAULT_LOOK
    head = load_shown_head(eyelid=eyelid, look=shown)
    formats = {name: each.suffix for name, each in convert.FORMATS.items()}
    signal.signal(signal.SIGTERM, _interrupted)
    with temporary_folder() as folder:
        results, temporary = folder / "results", folder / "temporary"
        results.mkdir()
        temporary.mkdir()
        of_streams = ("talkingeyes.apps.service.stream_worker:stream_worker", [str(streamed.absolute()), shown])
        of_files = ("talkingeyes.workflows.serve:file_workers", [str(for_files.absolute()), shown])
        if eyelid is not None:
            of_files[1].append(str(Path(eyelid).absolute()))
        resources = ServiceResources(
            WorkerPool(*of_files, limits.files, 2 * limits.files, temporary),
            WorkerPool(*of_streams, jobs, 0, temporary),
            head_glb(head),
            animator.persons,
            EMOTIONS,
            formats,
        )
        app = service_app(resources, limits, results, host, stream_origins)
        serve(app, host, port, on_start)


def find_live_model(model: Path, live: Path | str | None) -> Path:
    """The given model for streams, else the one beside the model for files, else the packaged one."""
    if live is not None:
        return Path(live)
    beside = model.parent / LIVE_MODEL_NAME
    return beside if beside.is_dir() else PACKAGED_LIVE_MODEL


def _interrupted(*_: Any) -> None:
    """Treat SIGTERM as an interruption, so that the temporary folder is removed."""
    raise KeyboardInterrupt


def file_workers(model: str, look: str, eyelid: str | None = None) -> Callable[[Any], Any]:
    """The message handler for files: ("perform", folder, request, seconds), ("export", ...), ("add_eyes", ...)."""
    import torch

    from talkingeyes.animation.animator import Animator
    from talkingeyes.head.looks import dressed_head

    torch.set_num_threads(1)
    animator, head = Animator.load(Path(model)), dressed_head(look)

    def perform(folder: Path, animation_request: AnimationRequest, max_duration_s: float) -> dict[str, Any]:
        from talkingeyes.apps.viewer.pose_encoding import pose_rows

        sound = _read_upload(folder / "upload", max_duration_s)
        (performance,) = animator.perform(
            sound, 1, animation_request.seed, animation_request.fps, animation_request.controls
        )
        performance.save(folder / "motion.npz")
        (folder / "request.json").write_text(animation_request.model_dump_json())
        soundfile.write(folder / "sound", sound, SAMPLE_RATE, format="WAV", subtype="PCM_16")
        motion = performance.motion
        rows = pose_rows(head, to_forward_axes(motion))
        (folder / "poses").write_bytes(rows.tobytes())
        return {"seconds": motion.seconds, "fps": motion.fps, "frames": len(motion), "columns": rows.shape[1]}

    def export(folder: Path, format: str, file: Path) -> None:
        sound = folder / "sound" if format == "mp4" else None
        lids = eyelid if convert.FORMATS[format].expression == "chosen" else None
        worn = look if format in convert.LOOK_FORMATS else None
        convert.export(folder / "motion.npz", file, format=format, sound=sound, eyelid=lids, look=worn, force=True)

    def add_eyes(folder: Path, face: Path, eyes: EyesRequest, max_duration_s: float) -> bytes:
        from talkingeyes.formats.editors.face_file import open_face_file
        from talkingeyes.workflows.add_eyes import EyeOptions, edit_face

        asked = AnimationRequest.model_validate_json((folder / "request.json").read_text())
        options = EyeOptions(asked.seed, asked.controls, eyes.keep_head, eyes.blend)
        try:
            file = open_face_file(face, eyes.fps)
            if file.motion.seconds > max_duration_s:
                raise InputError(f"{face}: should last at most {max_duration_s:g} s, got {file.motion.seconds:.1f} s")
            return edit_face(file, read_speech(folder / "sound"), animator, options)[0]
        except InputError as error:
            raise InputError(str(error).replace(str(face), "the face")) from None
        finally:
            face.unlink()

    handlers: dict[str, Callable[..., Any]] = {"perform": perform, "export": export, "add_eyes": add_eyes}
    return lambda message: handlers[message[0]](*message[1:])


def _read_upload(upload: Path, max_duration_s: float) -> Any:
    """The sound of an upload, which is deleted; errors do not mention its internal file name."""
    try:
        sound = read_speech(upload)
    except InputError as error:
        raise InputError(str(error).replace(str(upload), "the sound")) from None
    finally:
        upload.unlink()
    if len(sound) > max_duration_s * SAMPLE_RATE:
        raise InputError(f"the sound should last at most {max_duration_s:g} s, got {len(sound) / SAMPLE_RATE:.1f} s")
    return sound
