"""Perception studies of motions or films: `talkingeyes study make`, `run` and `results`.

`make` reads the conditions (output of the stage `sample`, the truth of a corpus, or folders of motions and films) and
writes a study folder (apps/study/study_folder.py). `run` serves it. `results` reads the answers and writes results.json
and results.md.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from talkingeyes.apps.study.counterbalancing import ATTENTION_CHECK
from talkingeyes.apps.study.design import Design, Stratum, load_design
from talkingeyes.apps.study.films import FilmContent, film_motion, reencode_film, trimmed, write_film
from talkingeyes.apps.study.results import preference_rates
from talkingeyes.apps.study.study_folder import Film, Study, film_id, required_films
from talkingeyes.apps.study.tables import table
from talkingeyes.apps.viewer.local_server import LOCALHOST, serve
from talkingeyes.core import output_folder
from talkingeyes.core.errors import InputError
from talkingeyes.corpus.index import Clip
from talkingeyes.corpus.motion_loading import load_motions
from talkingeyes.corpus.store import Corpus
from talkingeyes.orchestration.run import parallel_map
from talkingeyes.workflows.render import load_shown_head, parse_camera, retarget_to_head

TRUTH = "truth"
SIZE_PX = (16, 1080)
OWN_FILES = re.compile(r"study\.json|films|answers\.sqlite|results\.(json|md)")
PORT = 8020


@dataclass(frozen=True)
class FilmSources:
    """Sources of films: one file per clip for each condition (none for the truth), and the corpus."""

    corpus: Corpus
    clips: Mapping[str, Clip]
    files: Mapping[str, Mapping[str, Path]]


@dataclass(frozen=True)
class StudySummary:
    """Results of a study: its table, and numbers of participants."""

    table: str
    participant_count: int
    finished: int
    failed: int


def make_study(
    design: str,
    out: Path | str,
    *,
    data: Path | str = "data",
    corpus: Path | str | None = None,
    conditions: Mapping[str, Path | str] | None = None,
    without: Sequence[str] = (),
    seed: int = 0,
    size: int = 384,
    allow_fewer: bool = False,
    eyelid: Path | str | None = None,
    look: str | None = None,
    jobs: int = 1,
    force: bool = False,
) -> Study:
    """Choose clips, render the films of every condition, and write the study; returns it.

    `conditions` names folders of motions (.npz) or films (.mp4), named as clips, instead of those below `data`.
    `without` excludes conditions and their comparisons. `allow_fewer` accepts fewer clips than the design requires.
    `eyelid`: the lids of a person (`talkingeyes eyelid fit`) in all films that are rendered. `look`: that of
    the open head in them (`head.looks.LOOKS`).

    Raises InputError (one line) for invalid arguments.
    """
    asked = _without(load_design(design), without)
    output_path = output_folder.output_path(Path(out), OWN_FILES, force)
    if not SIZE_PX[0] <= size <= SIZE_PX[1]:
        raise InputError(f"size: should be {SIZE_PX[0]} to {SIZE_PX[1]} pixels, got {size}")
    parse_camera(asked.camera).view(size, size)
    load_shown_head(eyelid=eyelid, look=look)
    root = Path(data, "synthesize") if corpus is None else Path(corpus)
    film_sources = _material(asked, Corpus(root), Path(data), conditions or {})
    clips = _chosen(asked, film_sources, seed, allow_fewer)
    with output_folder.atomic_folder(output_path) as folder:
        study = Study(folder, asked, seed, clips)
        (folder / "films").mkdir()
        tasks = [
            (asked, film_sources, film, study.film(film_id(seed, film)), size, eyelid, look)
            for film in required_films(asked, clips)
        ]
        for _ in parallel_map(_draw, tasks, jobs, "films"):
            pass
        study.save()
    return Study.load(output_path)


def run_study(folder: Path | str, *, host: str = LOCALHOST, port: int = PORT, on_start: Callable[[str], None]) -> None:
    """Serve a study until interrupted; answers are stored, and participants can resume."""
    from talkingeyes.apps.study.server import study_app

    study = Study.load(Path(folder))
    study.answers.participants()  # report an unusable database now, not at the first answer
    serve(study_app(study, host), host, port, on_start)


def study_results(folder: Path | str) -> StudySummary:
    """The results of a study; also writes results.json and results.md beside its answers."""
    study = Study.load(Path(folder))
    everybody = study.answers.participants()
    found = preference_rates(study.design, study.answers.valid_answers())
    summary = StudySummary(
        table=table(study.design, found),
        participant_count=len(everybody),
        finished=sum(who.done and who.attention is not False for who in everybody),
        failed=sum(who.attention is False for who in everybody),
    )
    counts = {name: value for name, value in asdict(summary).items() if name != "table"}
    content = {"paper": study.design.paper, **counts, "preferences": [asdict(each) for each in found]}
    (study.root / "results.json").write_text(json.dumps(content, indent=1).replace("NaN", "null") + "\n")
    (study.root / "results.md").write_text(summary.table)
    return summary


def _without(design: Design, names: Sequence[str]) -> Design:
    """The design without some conditions and their comparisons."""
    for name in names:
        if name not in design.conditions:
            raise InputError(f"without: should be one of {', '.join(design.conditions)}, got {name!r}")
    left = tuple(pair for pair in design.comparisons if not set(pair) & set(names))
    if not left or design.attention.condition in names:
        raise InputError(f"without: should leave a comparison and {design.attention.condition}, got {', '.join(names)}")
    return design.model_copy(update={"comparisons": left})


def _material(design: Design, corpus: Corpus, data: Path, folders: Mapping[str, Path | str]) -> FilmSources:
    for name in folders:
        if name not in design.conditions:
            raise InputError(f"condition: should be one of {', '.join(design.conditions)}, got {name!r}")
    wanted = {name for pair in design.comparisons for name in pair} | {design.attention.condition}
    files = {}
    for name in sorted(wanted):
        source = design.conditions[name].source
        if name in folders or source != TRUTH:
            files[name] = _files_of(name, Path(folders[name]) if name in folders else data / source)
    if not corpus.has_truth and (design.shared_parts or wanted - set(files)):
        raise InputError(f"{corpus.root}: should be a corpus with truth, which the films of this design need")
    clips = {clip.id: clip for clip in corpus.select("test", "unseen", take=0)}
    return FilmSources(corpus, clips, files)


def _files_of(name: str, folder: Path) -> dict[str, Path]:
    """The motions and films in a folder, by clip; a motion takes precedence over a film."""
    found = {path.stem: path for suffix in ("*.mp4", "*.npz") for path in sorted(folder.rglob(suffix))}
    if not found:
        raise InputError(f"{name}: should have motions (.npz) or films (.mp4) in {folder}, got none")
    return found


def _chosen(design: Design, film_sources: FilmSources, seed: int, allow_fewer: bool) -> dict[str, tuple[str, ...]]:
    """Random clips of each stratum that all conditions have, and another clip for the attention check."""
    common = sorted(set(film_sources.clips).intersection(*map(set, film_sources.files.values())))
    rng = np.random.default_rng([seed, len(common)])
    shuffled = [common[place] for place in rng.permutation(len(common))]
    chosen: dict[str, tuple[str, ...]] = {}
    for stratum in design.strata:
        fitting = [clip for clip in shuffled if _fits(film_sources.clips[clip], stratum)]
        if len(fitting) < stratum.pool and not allow_fewer:
            raise InputError(
                f"{stratum.name}: should have {stratum.pool} clips that all conditions have, got {len(fitting)}; "
                "--allow-fewer accepts fewer"
            )
        if fitting:
            chosen[stratum.name] = tuple(fitting[: stratum.pool])
    taken = {clip for pool in chosen.values() for clip in pool}
    if not taken:
        raise InputError("clips: should contain one that all conditions have, got none")
    return {**chosen, ATTENTION_CHECK: (next((clip for clip in shuffled if clip not in taken), shuffled[0]),)}


def _fits(clip: Clip, stratum: Stratum) -> bool:
    return stratum.emotion in (None, clip.emotion) and (stratum.seconds or 0) <= clip.seconds


def _draw(task: tuple[Design, FilmSources, Film, Path, int, Path | str | None, str | None]) -> None:
    """Render one film."""
    design, film_sources, film, path, size, eyelid, look = task
    fault = design.attention.fault if film.condition == design.attention.fault else None
    name = design.attention.condition if fault else film.condition
    lasts = {stratum.name: stratum.seconds for stratum in design.strata}
    seconds = lasts.get(
        film.stratum, design.strata[0].seconds
    )  # the attention check has the length of the first stratum
    source = film_sources.files.get(name, {}).get(film.clip)
    if source is not None and source.suffix == ".mp4":
        reencode_film(source, seconds, fault, path)
        return
    clip, head = film_sources.clips[film.clip], load_shown_head(eyelid=eyelid, look=look)
    truth = film_sources.corpus.truth(clip) if film_sources.corpus.has_truth else None
    motion = truth if source is None else load_motions(source)[0]
    if motion is None:
        raise InputError(f"{name}: should have a motion for {film.clip}, got none")
    pictured = retarget_to_head(film_motion(design, motion, truth), head, None)
    static = design.conditions[name].lids == "static"
    shot = trimmed(FilmContent(pictured, film_sources.corpus.speech(clip), static, fault), seconds)
    write_film(shot, head, parse_camera(design.camera).view(size, size), path)
