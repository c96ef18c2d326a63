"""The service with its models: what `talkingeyes serve` does.

Reads one trained model for files and one for streams. Serves until interrupted; what clients send and get lies in a
temporary folder, which goes with it. The processes that work on files are `studio`s, those of streams are `speaker`s.
"""

from __future__ import annotations

import signal
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import soundfile

from talkingeyes.apps.service.wish import Limits, Wish
from talkingeyes.apps.viewer.serving import LOCAL, serve
from talkingeyes.audio.waveform import SAMPLE_RATE, read_speech
from talkingeyes.core.errors import InputError
from talkingeyes.workflows import convert

MODEL = Path("data", "train", "talkingeyes")
LIVE = "talkingeyes_live"
PORT = 8030
LIMITS = Limits(streams=10, stream_s=900, files=1, speech_s=60, upload_bytes=32 << 20, work_s=120, idle_s=10, kept=40)
FILM_PX = 384


def host_service(
    *,
    model: Path | str = MODEL,
    live: Path | str | None = None,
    host: str = LOCAL,
    port: int = PORT,
    limits: Limits = LIMITS,
    jobs: int = 2,
    started: Callable[[str], None],
) -> None:
    """Serve until interrupted; `started` is told the address.

    `live` is the model for streams: else that beside `model`, if there is one. `jobs` processes work on streams.
    Raises InputError (one line) for a model or a port that will not do.
    """
    from talkingeyes.animation.perform import Performer
    from talkingeyes.animation.streaming import LiveModel
    from talkingeyes.apps.service.app import Equipment, service_app
    from talkingeyes.apps.service.workers import Workers
    from talkingeyes.apps.viewer.head_file import head_glb
    from talkingeyes.head.anny import open_head

    beside = Path(model).parent / LIVE
    streamed = Path(live) if live is not None else beside if beside.is_dir() else None
    persons = Performer.load(Path(model)).persons
    speakers = None
    if streamed is not None:
        LiveModel.load(streamed)
        speakers = Workers("talkingeyes.apps.service.speaking:speaker", [str(streamed.resolve())], jobs, 0)
    studio = Workers("talkingeyes.workflows.serve:studio", [str(Path(model).resolve())], limits.files, 2 * limits.files)
    formats = {name: each.suffix for name, each in convert.FORMATS.items()}
    signal.signal(signal.SIGTERM, _interrupted)
    with tempfile.TemporaryDirectory(prefix="talkingeyes-") as folder:
        equipment = Equipment(studio, speakers, head_glb(open_head()), persons, formats)
        serve(service_app(equipment, limits, Path(folder), host), host, port, started)


def _interrupted(*_: Any) -> None:
    """Whoever ends the service by a signal interrupts it, so that its folder goes, too."""
    raise KeyboardInterrupt


def studio(model: str) -> Callable[[Any], Any]:
    """The function that answers messages about files: ("perform", folder, wish, seconds), ("export", folder, ...)."""
    import torch

    from talkingeyes.animation.perform import Performer
    from talkingeyes.head.anny import open_head

    torch.set_num_threads(1)
    performer, head = Performer.load(Path(model)), open_head()

    def perform(folder: Path, wish: Wish, longest_s: float) -> dict[str, Any]:
        from talkingeyes.apps.viewer.head_file import pose_rows

        sound = _heard(folder / "upload", longest_s)
        (performance,) = performer.perform(sound, 1, wish.seed, wish.fps, wish.direction)
        performance.save(folder / "motion.npz")
        soundfile.write(folder / "sound", sound, SAMPLE_RATE, format="WAV", subtype="PCM_16")
        motion = performance.motion
        rows = pose_rows(head, motion)
        (folder / "poses").write_bytes(rows.tobytes())
        return {"seconds": motion.seconds, "fps": motion.fps, "frames": len(motion), "columns": rows.shape[1]}

    def export(folder: Path, format: str, file: Path) -> None:
        sound = folder / "sound" if format == "mp4" else None
        convert.export(folder / "motion.npz", file, format=format, sound=sound, force=True)

    answers: dict[str, Callable[..., Any]] = {"perform": perform, "export": export}
    return lambda message: answers[message[0]](*message[1:])


def _heard(upload: Path, longest_s: float) -> Any:
    """The sound of an upload, which goes; what is wrong is said without the name that it has here."""
    try:
        sound = read_speech(upload)
    except InputError as error:
        raise InputError(str(error).replace(str(upload), "the sound")) from None
    finally:
        upload.unlink()
    if len(sound) > longest_s * SAMPLE_RATE:
        raise InputError(f"the sound should last at most {longest_s:g} s, got {len(sound) / SAMPLE_RATE:.1f} s")
    return sound
