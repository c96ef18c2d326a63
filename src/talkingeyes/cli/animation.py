"""`talkingeyes animate`: from speech (one or more sounds, or text) to motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from talkingeyes.cli.head_options import Eyelid, Look
from talkingeyes.cli.performance_options import (
    BlinkLiveliness,
    Blinks,
    Emotion,
    EyeContact,
    GazeLiveliness,
    HeadLiveliness,
    Intensity,
    ModelFile,
    Partner,
    Population,
    Seed,
    States,
    Style,
    Target,
)
from talkingeyes.core.errors import InputError

if TYPE_CHECKING:
    from talkingeyes.workflows.animate import AnimationOptions
    from talkingeyes.workflows.speak import SynthesizedSpeech


def animate(
    speech: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SPEECH",
            help="A sound file: wav, flac, ogg, mp3, m4a; 0.3 s to an hour; or several, or a folder.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="The folder to write: new, or empty. Default for one sound: its name."),
    ] = None,
    text: Annotated[str | None, typer.Option(help="Text to speak and animate instead of SPEECH.")] = None,
    voice: Annotated[
        str | None, typer.Option(help="Voice of --text: accent+variant of espeak-ng, such as en-us+f3.")
    ] = None,
    language: Annotated[str | None, typer.Option(help="Language of --text: en, fr, de, es, it, pt or nl.")] = None,
    samples: Annotated[int, typer.Option(help="Number of motions to sample.")] = 3,
    seed: Seed = 0,
    fps: Annotated[float, typer.Option(help="Frames per second, 10 to 240.")] = 25.0,
    blinks: Blinks = "physiological",
    target: Target = None,
    eye_contact: EyeContact = None,
    head_liveliness: HeadLiveliness = 1.0,
    gaze_liveliness: GazeLiveliness = 1.0,
    blink_liveliness: BlinkLiveliness = 1.0,
    partner: Partner = None,
    population: Population = "face_to_face",
    states: States = None,
    dialogue: Annotated[
        bool,
        typer.Option("--dialogue", help="Animate both speakers of a dialogue: two sounds, or one with two channels."),
    ] = False,
    person: Annotated[
        str | None,
        typer.Option(
            help="Training speaker, or a number for one of them (in a dialogue two: A,B). Default: set by the seed."
        ),
    ] = None,
    style: Style = None,
    no_postprocessing: Annotated[
        bool,
        typer.Option(help="Head and gaze as sampled, without rule-based layers (docs/whole.md)."),
    ] = False,
    emotion: Emotion = "neutral",
    intensity: Intensity = None,
    face_speaker: Annotated[str | None, typer.Option(help="Speaker of the face: one known to the face model.")] = None,
    without: Annotated[list[str] | None, typer.Option(help="A part to switch off: head, gaze, blinks or face.")] = None,
    replaced: Annotated[
        list[str] | None, typer.Option("--replace", help="PART=MOTION.npz: take a part from another motion.")
    ] = None,
    model: ModelFile = None,
    formats: Annotated[
        list[str] | None, typer.Option("-f", "--format", help="Also write this format, as `export` does; repeatable.")
    ] = None,
    flame: Annotated[Path | None, typer.Option(help="Your FLAME file, for formats that need one.")] = None,
    eyes: Annotated[
        str,
        typer.Option(
            help="Forward axes of the eyes in the formats: visual (lines of sight) or optical (for photographs)."
        ),
    ] = "visual",
    eyelid: Eyelid = None,
    look: Look = None,
    previews: Annotated[
        bool, typer.Option(help="Write a small video of each motion, a plot and a contact sheet.")
    ] = True,
    jobs: Annotated[int | None, typer.Option(help="Number of processes; each sound gets its own folder.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the output of an earlier run.")] = False,
) -> None:
    """Sample motions for speech: npz, events, a small video with sound for each, and a plot of all."""
    from talkingeyes.workflows.animate import AnimationOptions
    from talkingeyes.workflows.direct import make_controls

    sounds = speech or []
    if out is None:
        if text is not None or dialogue or len(sounds) != 1 or sounds[0].is_dir():
            raise InputError("out: should be the folder to write (-o DIR), got none")
        out = Path(sounds[0].stem)
    if (text is None) == (not sounds):
        raise InputError(f"speech: should be sound files or --text, got {'neither' if text is None else 'both'}")
    if text is None and (voice or language):
        raise InputError("voice: should be used with --text, got a sound file")
    controls = make_controls(
        blinks=blinks,
        target=target,
        eye_contact=eye_contact,
        head=head_liveliness,
        gaze=gaze_liveliness,
        blinking=blink_liveliness,
        partner=partner,
        population=population,
        states=states,
        person=person,
        style=style,
        no_postprocessing=no_postprocessing,
        emotion=emotion,
        intensity=intensity,
        speaker=face_speaker,
        without=without or (),
        replaced=_parts(replaced or []),
    )
    options = AnimationOptions(
        samples, seed, float(fps), controls, tuple(formats or ()), previews, flame, eyes, eyelid, look
    )
    if dialogue:
        _animate_dialogue(sounds, out, options, model, force)
        return
    if len(sounds) > 1 or any(path.is_dir() for path in sounds) or (jobs is not None and sounds):
        _animate_all(sounds, out, options, model, 1 if jobs is None else jobs, force)
        return
    if text is None:
        _animate_one(sounds[0], out, options, model, force)
        return
    from talkingeyes.models.face.style import default_intensity
    from talkingeyes.workflows.speak import speak

    emotion_intensity = default_intensity(emotion, intensity)
    spoken = speak(text, voice=voice, language=language, emotion=emotion, intensity=emotion_intensity)
    _animate_one(spoken, out, options, model, force)


def _parts(replaced: list[str]) -> dict[str, str]:
    """Parse PART=FILE arguments. Raises InputError for an invalid or repeated part."""
    found = dict(each.split("=", 1) for each in replaced if "=" in each)
    if len(found) < len(replaced):
        raise InputError(f"replace: should be PART=MOTION.npz, each part once, got {' '.join(replaced)}")
    return found


def _animate_dialogue(
    sounds: list[Path], out: Path, options: AnimationOptions, model: Path | None, force: bool
) -> None:
    from talkingeyes.audio.waveform import read_dialogue, read_speech
    from talkingeyes.workflows.animate import run_dialogue

    if len(sounds) not in (1, 2) or options.controls.partner is not None:
        raise InputError(
            f"dialogue: should be two sounds, or one with two channels, without --partner, got {len(sounds)}"
        )
    if options.controls.states not in (None, "auto"):
        raise InputError("states: should be auto in a dialogue, where each speaker has states of their own, got a file")
    voices = read_dialogue(sounds[0]) if len(sounds) == 1 else tuple(read_speech(path) for path in sounds)
    dialogues = run_dialogue(voices, out, options, model, force)
    first = dialogues[0].first.motion
    typer.echo(
        f"{out}: {len(dialogues)} for two speakers, {first.seconds:.2f} s at {options.fps:g} fps; {_used(model)}"
    )


def _animate_one(
    speech: Path | SynthesizedSpeech, out: Path, options: AnimationOptions, model: Path | None, force: bool
) -> None:
    from talkingeyes.workflows.animate import run_animation

    performances = run_animation(speech, out, options, model, force)
    count = "1 motion" if options.samples == 1 else f"{options.samples} motions"
    seconds = performances[0].motion.seconds
    typer.echo(f"{out}: {count} of {seconds:.2f} s at {options.fps:g} fps; {_used(model)}")


def _used(model: Path | None) -> str:
    from talkingeyes.animation.model_file import find_model, parts_title

    return parts_title(find_model(model))


def _animate_all(
    sounds: list[Path], out: Path, options: AnimationOptions, model: Path | None, jobs: int, force: bool
) -> None:
    from talkingeyes.workflows.animate_batch import DONE, FAILED, SKIPPED, animate_all

    lines = animate_all(sounds, out, options, model=model, jobs=jobs, force=force)
    counts = {status: sum(line.status == status for line in lines) for status in (DONE, SKIPPED, FAILED)}
    done = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    typer.echo(f"{out}: {done}; {_used(model)}")
    failed = [line for line in lines if line.status == FAILED]
    if failed:
        raise InputError(f"{len(failed)} of {len(lines)} failed ({out / 'summary.csv'}); the first: {failed[0].reason}")
