"""Estimate a population of gaze from recorded people in conversation: physiology/populations/remote_call.yaml.

Run     python -m pipelines.population [PEOPLE]        (eight minutes of a core)
Reads   PEOPLE (../shared/data/real/gaze/conversation_fixations.csv.gz), of which four people are kept for validation
Writes  src/talkingeyes/physiology/populations/remote_call.yaml
Prints  what the recordings give, and what the estimated population gives through the simulated tracker; then the
        distance of synthetic people of both populations to all recorded people, and to the four kept back

The synthetic people talk in turns of half a minute, of which the first and the last three seconds do not count, as in
the recordings; there is no sound. Not a stage: the recordings are no part of the project. `synthesize.population:
remote_call` samples people from the file.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML

from pipelines.results.people import RECORDED
from talkingeyes.audio.annotation import Annotation, Span
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.corpus.motion_files import MotionFields
from talkingeyes.evaluation.bootstrap import BootstrapSettings
from talkingeyes.evaluation.people.comparison import as_text, compare_with_people
from talkingeyes.evaluation.people.fixations import Person, read_people, split_people
from talkingeyes.evaluation.people.population import (
    SIMULATED_PEOPLE,
    as_mapping,
    corrected_population,
    estimate_population,
    simulate_people,
)
from talkingeyes.evaluation.people.tracker import TRACKER, record_person
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.orchestration.run import run_command
from talkingeyes.physiology.blinks import PHYSIOLOGICAL
from talkingeyes.physiology.gaze_population import FOLDER, STATES, GazePopulation
from talkingeyes.synthesis.speakers import sample_style, with_habits
from talkingeyes.synthesis.take import sample_take
from talkingeyes.workflows.evaluate_people import gaze_clip

SOURCE = "Dembinsky, Watanabe, Dengel & Ishimaru 2024 (ETRA), doi 10.1145/3649902.3653337, Apache-2.0; people 00 to 07"
HEADER = """# Gaze of people in remote calls, estimated by `python -m pipelines.population`; do not edit. Parameters:
# physiology/gaze_population.py. Standard errors are those of eight people, before the correction for the tracker.
# Under `standard_errors`: of the standard deviation (sd) of each parameter of a person, and of each shared parameter.
"""
SEED = 0
POPULATIONS = ("face_to_face", "remote_call")
SYNTHETIC_PEOPLE, CLIPS, TURN_S, GAP_S, MARGIN_S, FPS = 40, 2, 30.0, 0.2, 3.0, 25.0
TURNS = [Span(start_s, start_s + TURN_S) for start_s in np.arange(4) * (TURN_S + GAP_S)]
CONVERSATION = Annotation(speaking=tuple(TURNS[::2]), listening=tuple(TURNS[1::2]))
BOOTSTRAP = BootstrapSettings(n_resamples=300, confidence_level=0.95, seed=0)


def main() -> None:
    """Estimate, write the file, and compare: through the tracker, and synthetic people with recorded ones."""
    people = read_people(Path(sys.argv[1]) if len(sys.argv) > 1 else RECORDED)
    used, kept_back = split_people(people)
    population = corrected_population(used, SOURCE, SEED)
    writer = YAML()
    writer.default_flow_style = None
    with atomic_write(FOLDER / "remote_call.yaml") as temporary, temporary.open("w") as file:
        file.write(HEADER)
        writer.dump(as_mapping(population), file)
    seen = estimate_population(simulate_people(population, SIMULATED_PEOPLE, SEED + 1000), SOURCE)
    print(table(estimate_population(used, SOURCE), population, seen))
    rows = {name: [synthetic_person(index, name) for index in range(SYNTHETIC_PEOPLE)] for name in POPULATIONS}
    for title, group in (("all recorded people", people), ("the people kept back", kept_back)):
        print(f"\nBeside {title}\n\n{as_text(compare_with_people(group, rows, BOOTSTRAP))}")


def synthetic_person(index: int, population: str) -> Person:
    """A synthetic person, as the tracker records him in long turns."""
    rng = np.random.default_rng([SEED, index])
    style = sample_style(rng)
    if population == "remote_call":
        style = with_habits(style, population, np.random.default_rng([SEED, index, 1]))
    clips = []
    for _ in range(CLIPS):
        seconds = TURNS[-1].end_s
        motion = sample_take(CONVERSATION, style, seconds, rng, PHYSIOLOGICAL).motion(FPS, int(seconds * FPS))
        fields = {"head": motion.head, "gaze": motion.gaze, "lid": motion.lid}
        clip = gaze_clip(MotionFields(FPS, fields, None), CONVERSATION)
        times_s = np.arange(len(clip.state)) / FPS
        counted = np.any([(times_s > turn.start_s + MARGIN_S) & (times_s < turn.end_s - MARGIN_S) for turn in TURNS], 0)
        clips.append(replace(clip, lost=clip.lost | ~counted))
    return record_person(str(index), clips, TRACKER, rng)


def table(recorded: GazePopulation, population: GazePopulation, seen: GazePopulation) -> str:
    """Every parameter as recorded, as estimated, and as the estimated population appears in the tracker."""
    rows = []
    for state in STATES:
        for name, each in recorded.states[state].people.items():
            others = (population.states[state].people[name], seen.states[state].people[name])
            error = population.states[state].standard_errors[name]
            cells = [f"{each.mean:.2f} ± {each.standard_error:.2f} (SD {each.sd:.2f} ± {error:.2f})"]
            rows.append([state, name, *cells, *(f"{other.mean:.2f} (SD {other.sd:.2f})" for other in others)])
        for name, value in recorded.states[state].shared.model_dump().items():
            values = (getattr(one.states[state].shared, name) for one in (population, seen))
            error = population.states[state].standard_errors[name]
            rows.append([state, name, f"{value:.2f} ± {error:.2f}", *(f"{other:.2f}" for other in values)])
    return markdown_table(["state", "parameter", "recorded", "population", "population, through the tracker"], rows)


if __name__ == "__main__":
    run_command(main)
