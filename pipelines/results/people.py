"""Gaze of the default chain against recorded people in conversation: the page docs/results/people.md.

Run     python -m pipelines.results.people [PEOPLE [DATA]]        (after make repro)
Reads   PEOPLE (../shared/data/real/gaze/conversation_fixations.csv.gz); corpus and samples in DATA (data/);
        docs/results/people_timing.json (python -m pipelines.results.people_timing)
Writes  docs/results/people.json and docs/results/people.md

Each row is what `talkingeyes evaluate MOTIONS --people DATA --reference CORPUS` prints. Not a stage: the recordings are
no part of the project.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipelines.results import people_timing_page
from pipelines.results.result_tables import ResultTable
from talkingeyes.core.atomic_file import atomic_write
from talkingeyes.core.containers import read_json
from talkingeyes.core.errors import InputError
from talkingeyes.evaluation.people.comparison import state_table
from talkingeyes.orchestration.run import Workspace, run_command
from talkingeyes.workflows.evaluate_people import MOTIONS, RANDOM, TRUTH, UNIFORM, evaluate_people

RECORDED = Path(__file__).resolve().parents[3] / "shared/data/real/gaze/conversation_fixations.csv.gz"
GROUPS = {
    "default": "sample/talkingeyes_events",
    "live": "sample/talkingeyes_live",
    "similar": "sample/similar",
    "untrained": "sample/untrained",
}
DOCS = Path("docs/results")
PASSED = 1.0  # ratio that a baseline passes
BASELINES = (RANDOM, "similar", "untrained")
NEAR = 0.05  # a choice; intervals of the mean ratio are some 0.4 wide

SHOWN = ("measure", "people (range)", RANDOM, TRUTH, *GROUPS)

PAGE = """# Gaze against recorded people

    talkingeyes evaluate MOTION_DIR --people DATA [--reference CORPUS] [--sound DIR] [-o DIR]

compares where and how long generated faces look with people in conversation, while they speak and while they listen.
It prints a table for each state and writes `people.json`. With conversations in place of fixations,

    talkingeyes evaluate MOTION_DIR --people CONTACT --turns TURNS [--reference CORPUS] [--sound DIR] [-o DIR]

compares when they look away, and writes `timing.json`. This page is written by `python -m pipelines.results.people` and
`python -m pipelines.results.people_timing`; all rows and intervals are in [people.json](people.json) and
[people_timing.json](people_timing.json).

{timing}

## Remote calls: input

- `MOTION_DIR`: motion files as for the [benchmark](../benchmark.md), with `head` and `gaze`; `lid` gives blinks.
- `DATA`: fixations of people, a CSV table with the columns participant, state (SPEAK, LISTEN), segment, start_sample,
  duration_ms, center_x_px, center_y_px.
- `--reference`: a corpus whose clips the files are named after. It says who speaks when, and gives the rows `truth` and
  `random`. Or `--sound`: a folder of sounds named as the files, in which speech is detected by level.

Turns of the partner and silences of 2 s or more are listening; all else is speaking. No trained model is needed. The
two-sample test needs scikit-learn (`pip install 'talkingeyes[platform]'`).

The people of this page: Dembinsky, Watanabe, Dengel & Ishimaru 2024, *Eye Movement in a Controlled Dialogue Setting*
(ETRA), doi 10.1145/3649902.3653337, Apache-2.0, <https://github.com/psyberlab/eye-gaze-during-conversation-dataset>.
Convert the `fixations.pkl` of `data/0` to `data/11` to one CSV file with the columns above. Participants {validation}
are kept for validation; the tracker is estimated from the others. The other figures use all {people}. The recordings
are not part of this project.

## Remote calls: method

- Generated gaze passes a simulated screen tracker: 90 Hz, white noise of {noise_deg:g} and slow noise of {drift_deg:g}
  degrees (time constant {drift_s:g} s), {speaking_loss:g} random losses per second while speaking and
  {listening_loss:g} while listening, and losses at blinks (`evaluation/people/tracker.py`). Fixations are found by the
  algorithm of the data set (100 ms or longer within 30 pixels) and merged if nearer than 1.5 degrees.
- A lost sample ends a segment, so most last about a second. Rates are events per observed second. Durations are
  Kaplan-Meier means up to 1.5 s.
- The partner is the densest place of fixations while listening, with a radius of 4 degrees.
- The ratio in square brackets is the distance between the medians over speakers and over people, divided by the mean
  distance of two people: 1 is the distance of one person from another. `*`: speakers pooled, because fewer than five
  have enough data.
- Two-sample test: AUC of a classifier of sequences of ten fixations, on people and speakers that it was not trained
  on; 0.5 means that it cannot tell them apart. The people's own cell is people against other people.
- Intervals (95 %) resample people and speakers. Distances cannot be negative, so intervals lie high.

Rows: `random` is the true motion of a random training clip under another sound, `truth` the synthetic data, `similar`
the motion of a training clip with a similar sound, `untrained` the default with random weights. Two more are in the
JSON file: `re-recorded`, the people's own fixations recorded by the simulated tracker, and `uniform`, eyes that jump to
a uniformly random direction every 0.2 to 5 s, head still.

{states}

## Remote calls: what it shows

{findings}

## Limits

- The people sit before a screen in a remote call: looks around the room are mostly lost. The corpus of this page is
  `face_to_face`. The packaged `talkingeyes_remote_call`, trained on `synthesize.population=remote_call`, is nearer to
  them: mean and largest ratio 0.37 and 0.84 while speaking, 0.85 and 1.56 while listening; AUC 0.93 and 0.96. Eight of
  them gave the population; beside the other four alone: 0.40 and 0.93, 0.92 and 2.75; 0.97 and 0.95
  ([log](../log/2026-11-27-remote-call-model.md)).
- The recordings leave out the first and the last three seconds of each turn, so looking away when a turn starts is not
  in them.
- Clips last 8 to 10 s, and few have a partner: listening rests on {listening} s of the default's motions.
- Rows of unseen speakers mix people: the default samples a random training speaker for each sample.
- A row without a measure (`-`) has its mean over the others.
"""


def compute(data: Path, recorded: Path, corpus: Path) -> dict[str, Any]:
    """All rows: the baselines, then the groups that exist."""
    groups = {name: data / folder for name, folder in GROUPS.items() if (data / folder).is_dir()}
    if not groups:
        raise InputError(f"{data}: should hold one of {', '.join(GROUPS.values())}, got none; run `make repro`")
    first, *others = groups
    found = evaluate_people(groups[first], recorded, reference=corpus, others={name: groups[name] for name in others})
    content = found.content | {"notes": []}
    for each in content["states"].values():
        each["rows"] = {first if name == MOTIONS else name: row for name, row in each["rows"].items()}
    return content


def page(content: Mapping[str, Any], timing: Mapping[str, Any]) -> str:
    """The page of both results: fixations in remote calls, and timing face to face."""
    tracker = content["tracker"]
    states = [f"## Remote calls: while {state}\n\n{_table(content, state)}" for state in content["states"]]
    return PAGE.format(
        timing=people_timing_page.section(timing),
        **{name: tracker[name] for name in ("noise_deg", "drift_deg", "drift_s")},
        speaking_loss=tracker["loss_per_s"][0],
        listening_loss=tracker["loss_per_s"][1],
        validation=", ".join(content["validation_people"]),
        people=len(content["people"]),
        states="\n\n".join(states),
        findings="\n".join(findings(content)),
        listening=f"{content['states']['listening']['rows']['default']['seconds']:.0f}",
    )


def _table(content: Mapping[str, Any], state: str) -> str:
    """The table of a state with the columns that the page has."""
    heading, *rows = map(tuple, state_table(content, state))
    return ResultTable(state, heading, tuple(rows)).markdown(SHOWN)


def findings(content: Mapping[str, Any]) -> list[str]:
    """Rows that reach the targets, and how many measures each baseline passes, as lines of a list."""
    lines = []
    for state, each in content["states"].items():
        rows = each["rows"]
        target = content["targets"]["mean_ratio"][state]
        reached = [name for name, row in rows.items() if row["mean_ratio"] and row["mean_ratio"]["value"] <= target]
        lines.append(f"- While {state}, the target of {target:g} for the mean ratio is reached by {_listed(reached)}.")
        ratios = {name: row["mean_ratio"]["value"] for name, row in rows.items() if row["mean_ratio"]}
        near = [f"`{name}`" for name in BASELINES if ratios[name] <= ratios["default"] + NEAR]
        so = " The mean ratio does not show what was learnt." if near else ""
        lines.append(
            f"- While {state}, baselines at most {NEAR:g} farther from people than the default: {_listed(near)}.{so}"
        )
        passed = {
            name: sum(found["ratio"]["value"] <= PASSED for found in rows[name]["measures"].values())
            for name in (UNIFORM, RANDOM)
        }
        counts = " and ".join(f"`{name}` in {count}" for name, count in passed.items())
        lines.append(f"- While {state}, {counts} measures have a ratio of {PASSED:g} or less: one alone proves little.")
    return lines


def _listed(names: list[str]) -> str:
    return "; ".join(names) if names else "none"


def main() -> None:
    """Measure, and write the page."""
    workspace = Workspace.open(Path())
    recorded = Path(sys.argv[1]) if sys.argv[1:] else RECORDED
    data = Path(sys.argv[2]) if sys.argv[2:] else workspace.root / "data"
    if not recorded.is_file():
        raise InputError(
            f"{recorded}: should be the table of recorded people, got none (docs/results/people.md says where)"
        )
    timing = read_json(DOCS / "people_timing.json", "result")
    content = compute(data, recorded, data / "synthesize")
    for name, text in (("people.json", json.dumps(content, indent=1) + "\n"), ("people.md", page(content, timing))):
        with atomic_write(DOCS / name) as path:
            path.write_text(text)


if __name__ == "__main__":
    run_command(main)
