"""Estimate eye contact from recorded pairs and interviews: physiology/populations/face_to_face.yaml.

Run     python -m pipelines.contact_population [FOLDER]        (ten minutes of a core)
Reads   FOLDER (../shared/data/real/gaze): face_to_face_contact.csv.gz, face_to_face_turns.csv.gz,
        interview_contact.csv.gz
Writes  src/talkingeyes/physiology/populations/face_to_face.yaml, estimated from all pairs and interviews
Prints  how far synthetic people are from the recorded ones on pairs that were kept back (three folds over pairs), and
        the moments of the final population

Synthetic speech is laid on the recorded turns, whose changes are moved by up to half a second, since the recordings
have them to the second. Not a stage: the recordings are no part of the project.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
from ruamel.yaml import YAML

from pipelines.results.people import RECORDED
from talkingeyes.audio.annotation import Span
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.containers import read_csv
from talkingeyes.core.progress import progress_bar
from talkingeyes.evaluation.people.contact import (
    Conversation,
    contact_moments,
    estimate_contact,
    estimate_interview,
    read_interviews,
    simulate_contact,
    state_moments,
)
from talkingeyes.evaluation.people.conversations import AGREED, ConversationGaze, read_conversations
from talkingeyes.evaluation.text_tables import markdown_table
from talkingeyes.orchestration.run import run_command
from talkingeyes.physiology.contact_population import ContactCues, ContactPopulation, StateContact
from talkingeyes.physiology.gaze_population import FOLDER
from talkingeyes.synthesis.speech_synthesis import DialogueVoices, synthesize_turns
from talkingeyes.synthesis.voice_profiles import sample_voice

SOURCE = (
    "Wohltjen & Wheatley 2021 (PNAS 118(37)), doi 10.1073/pnas.2106645118, 24 pairs; interviews: github.com/ut-vision/"
    "Video-Independent-ECS (ACCV 2022), 26 videos"
)
HEADER = """# Eye contact face to face and in interviews, estimated by
# `python -m pipelines.contact_population`; do not edit. Parameters: physiology/contact_population.py.
"""
# Where the table has persons a and b exchanged. Coder 1 of four pairs: both coders agree only if exchanged (kappa 0.43
# to 0.74 instead of -0.24 to -0.02). Turns of D021: both coders see both persons look away far more in the other's
# turns (by 0.46 and 0.27), which nobody else does.
EXCHANGED_LOOKS = {("D011", "1"), ("D013", "1"), ("D015", "1"), ("D019", "1")}
EXCHANGED_TURNS = {"D021"}
FOLDS, SEED, TAKES, RESAMPLES, JITTER_S = 3, 0, 2, 60, 0.5
LANGUAGE = "en"
# Where the search starts: round numbers that owe nothing to these recordings, so that pairs are really kept back.
_LAW = StateContact(logit_share=0.0, logit_share_sd=0.7, away_s=1.0, away_log_sd=0.7, look_log_sd=0.7, look_scale=1.5)
START = ContactPopulation(
    source=SOURCE,
    states={"speaking": _LAW, "listening": _LAW, "interview": _LAW},
    share_correlation=0.3,
    dwell_log_sd=0.3,
    cues=ContactCues(
        planning=0.3,
        floor=0.3,
        turn_end=0.3,
        pause=0.3,
        planned_s=3.0,
        aversion_start_s=(0.0, 0.5),
        aversion_end_s=(2.0, 0.5),
        return_s=(-0.5, 0.5),
    ),
)


def main() -> None:
    """Judge by folds, estimate from all, write the file."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else RECORDED.parent
    people = read_people(folder, Path("build/contact"))
    conversations = [
        speech_on_turns(index, each) for index, each in enumerate(progress_bar(next(iter(people.values())), "speech"))
    ]
    units = sorted({each.unit for each in conversations})
    simulated: list[ConversationGaze] = []
    for fold in range(FOLDS):
        kept_back = set(units[fold::FOLDS])
        used = [each for each in conversations if each.unit not in kept_back]
        of_used = {coder: [each for each in gazes if each.unit not in kept_back] for coder, gazes in people.items()}
        population = estimate_contact(of_used, used, START, SEED)
        judged = [each for each in conversations if each.unit in kept_back]
        simulated += simulate_contact(population, judged, TAKES, SEED + 1000)
    begun = simulate_contact(START, conversations, TAKES, SEED + 1000)
    print(distances_table({"start of the search": begun, "face_to_face, kept back": simulated}, people))
    population = estimate_contact(people, conversations, START, SEED)
    interviews = read_interviews(folder / "interview_contact.csv.gz")
    monologues = [speech_on_turns(index, each) for index, each in enumerate(progress_bar(interviews, "interviews"))]
    population = estimate_interview(interviews, monologues, population, SEED).model_copy(update={"source": SOURCE})
    write(population)
    rows = [
        contact_moments(gazes)
        for gazes in (*people.values(), simulate_contact(population, conversations, TAKES, SEED + 1000))
    ]
    print(moments_table([f"coder {name}" for name in people], rows))
    talks = [interviews, simulate_contact(population, monologues, TAKES, SEED + 1000)]
    print(moments_table(["interviews"], [state_moments(each, "interview") for each in talks]))


def read_people(folder: Path, build: Path) -> dict[str, list[ConversationGaze]]:
    """Gaze of all people by coder, with exchanged persons corrected."""
    return {name: each for name, each in read_conversations(*corrected_tables(folder, build)).items() if name != AGREED}


def corrected_tables(folder: Path, build: Path) -> tuple[Path, Path]:
    """Write the tables of looks and of turns with exchanged persons corrected."""
    build.mkdir(parents=True, exist_ok=True)
    looks, turns = (read_csv(folder / f"face_to_face_{name}.csv.gz") for name in ("contact", "turns"))
    keys = zip(looks["pair"].to_pylist(), map(str, looks["coder"].to_pylist()), strict=True)
    wrong = [[key in EXCHANGED_LOOKS for key in keys], [pair in EXCHANGED_TURNS for pair in turns["pair"].to_pylist()]]
    paths = []
    for name, column, table, exchanged in zip(
        ("contact", "turns"), ("person", "speaker"), (looks, turns), wrong, strict=True
    ):
        persons = [
            {"a": "b", "b": "a"}[each] if swap else each
            for each, swap in zip(table[column].to_pylist(), exchanged, strict=True)
        ]
        paths.append(build / f"{name}.csv")
        corrected = table.set_column(table.column_names.index(column), column, pa.array(persons))
        pyarrow.csv.write_csv(corrected, paths[-1])
    return paths[0], paths[1]


def speech_on_turns(index: int, gaze: ConversationGaze) -> Conversation:
    """Synthetic speech on the turns of a person."""
    seconds = max(span.end_s for span in gaze.turns.own + gaze.turns.partner)
    rng = np.random.default_rng([SEED, index])
    edges = sorted({edge for span in gaze.turns.own + gaze.turns.partner for edge in (span.start_s, span.end_s)})
    moved = {edge: max(0.0, edge + rng.uniform(-JITTER_S, JITTER_S)) for edge in edges}
    own, partner = (
        tuple(Span(moved[span.start_s], moved[span.end_s]) for span in spans)
        for spans in (gaze.turns.own, gaze.turns.partner)
    )
    voices = DialogueVoices(sample_voice(rng, LANGUAGE), sample_voice(rng, LANGUAGE))
    annotation = synthesize_turns(voices, (own, partner), seconds, rng).annotation
    return Conversation(gaze.unit, annotation, gaze.turns, seconds)


def distances(found: Mapping[str, float], people: Mapping[str, float]) -> list[float]:
    """Mean absolute differences of moments: share averted around starts and ends of turns, shares of time, log
    quantiles of durations, looks away a minute."""
    groups = ("start.", "end.", ("own", "partners"), ".log_q", "looks_away")
    return [
        float(np.mean([abs(found[name] - people[name]) for name in people if _belongs(name, group)]))
        for group in groups
    ]


def _belongs(name: str, group: str | tuple[str, ...]) -> bool:
    return name in group if isinstance(group, tuple) else name.startswith(group) or (group[0] == "." and group in name)


def distances_table(
    rows: Mapping[str, Sequence[ConversationGaze]], people: Mapping[str, Sequence[ConversationGaze]]
) -> str:
    """Distances of each row to each coder's people, with 95 % intervals over pairs."""
    heading = ["", "starts", "ends", "shares", "durations, log", "looks away, 1/min"]
    rng, table = np.random.default_rng(SEED), []
    units = sorted({each.unit for each in next(iter(people.values()))})
    draws = [units, *(rng.choice(units, len(units)).tolist() for _ in range(RESAMPLES))]
    for name, simulated in rows.items():
        for coder, recorded in people.items():
            values = []
            for chosen in draws:
                both = [
                    [each for unit in chosen for each in group if each.unit == unit] for group in (simulated, recorded)
                ]
                values.append(distances(*map(contact_moments, both)))
            low, high = np.quantile(values[1:], (0.025, 0.975), axis=0)
            cells = [f"{value:.3f} ({a:.3f} to {b:.3f})" for value, a, b in zip(values[0], low, high, strict=True)]
            table.append([f"{name}, coder {coder}", *cells])
    return markdown_table(heading, table)


def moments_table(names: Sequence[str], rows: Sequence[Mapping[str, float]]) -> str:
    """All moments of people and of the population."""
    return markdown_table(
        ["moment", *names, "population"], [[name, *(f"{each[name]:.2f}" for each in rows)] for name in rows[0]]
    )


def write(population: ContactPopulation) -> None:
    """Write the file of the package, with three digits."""

    def rounded(node: object) -> object:
        if isinstance(node, Mapping):
            return {key: rounded(each) for key, each in node.items()}
        if isinstance(node, (list, tuple)):
            return [rounded(each) for each in node]
        return float(f"{node:.3g}") if isinstance(node, float) else node

    writer = YAML()
    writer.default_flow_style = None
    with atomic_write(FOLDER / "face_to_face.yaml") as temporary, temporary.open("w") as file:
        file.write(HEADER)
        writer.dump(rounded(population.model_dump(mode="json")), file)


if __name__ == "__main__":
    run_command(main)
